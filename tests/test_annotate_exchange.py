"""Every format returns a label set to the bit, and other tools read the exports."""

import json
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import assert_refused, tree
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.exchange import coco as coco_format
from annotate.exchange import companion as companion_format
from annotate.exchange import cvat as cvat_format
from annotate.exchange import parquet as parquet_format
from annotate.exchange.coco import ANNOTATIONS, rle_from_string, rle_to_string
from annotate.exchange.companion import COMPANION, Companion
from annotate.exchange.cvat import ANNOTATIONS as XML
from annotate.exchange.formats import FORMATS, export_labels, import_labels, recognise
from annotate.exchange.masks import mask_from_runs, runs_of
from annotate.frame_labels import FrameLabels
from annotate.labelset.journal import JOURNAL
from annotate.labelset.label_set import LabelSet
from annotate.parts import PARTS
from sensors.errors import CloudError, FormatError
from sensors.importers.clouds import records
from sensors.importers.open_source import open_source
from sensors.rig.camera import Intrinsics, unproject
from tests.helpers.same_frame import assert_same_frame

law = settings(deadline=None, max_examples=12)
HOSTILE = ["", "P1", "../../etc", "<b>x</b>", '"; DROP', "a\0b", "\ud800", "]]>", "&amp;", "名前"]
HOSTILE += ["x\r\ny", "=1+1"]


def nothing(_: int) -> None:
    pass


@st.composite
def label_sets(draw) -> tuple[Intrinsics, list[FrameLabels]]:
    """One to three frames of any odd size: empty persons, undefined pixels, hostile subjects."""
    height, width = draw(st.integers(1, 9)), draw(st.integers(1, 11))
    fx, fy = draw(st.floats(5, 600)), draw(st.floats(5, 600))
    camera = Intrinsics(width, height, fx, fy, width / 3, height / 2)
    frames = []
    for number in range(draw(st.integers(1, 3))):
        rng = np.random.default_rng(draw(st.integers(0, 10**6)))
        ids = draw(st.sampled_from([[0], [255], [0, 255], [0, 1, 2, 255], [*range(12), 255]]))
        parts = rng.choice(ids, (height, width)).astype(np.uint8)
        depth = (rng.integers(0, 65536, parts.shape) * (rng.random(parts.shape) < 0.7)).astype(np.uint16)
        confidence = (rng.integers(0, 256, parts.shape) / np.float32(255)).astype(np.float32)
        numbers = draw(st.sampled_from([[0], [0, 1], [0, 1, 2, 200, 255]]))
        persons = rng.choice(numbers, parts.shape).astype(np.uint8)
        frame_id = draw(st.sampled_from(["000", "a.b-", "_", "Z" * 90])) + str(number)
        status = draw(st.sampled_from(["auto", "corrected", "reviewed", "truth"]))
        notes = {"why": draw(st.sampled_from(HOSTILE)), "n": [1, None, 0.5]}
        confidence, persons = (draw(st.none() | st.just(image)) for image in (confidence, persons))
        subject = draw(st.sampled_from(HOSTILE))
        frames.append(FrameLabels(frame_id, depth, parts, confidence, status, subject, notes, persons))
    return camera, frames


def make(path: Path, camera: Intrinsics, frames: list[FrameLabels]) -> LabelSet:
    labels = LabelSet.create(path, camera, {})
    for frame in frames:
        labels.write(frame)
    return labels


@pytest.mark.parametrize("name", FORMATS)
@given(made=label_sets())
@law
def test_a_round_trip_changes_nothing(name, made):
    camera, frames = made
    chosen = FORMATS[name]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        companion = Companion(camera)
        for frame in frames:
            companion.add(frame)
        chosen.write(iter(frames), camera, out)
        companion.save(out)
        assert recognise(out) == name
        found = chosen.companion(out)
        got = {frame.frame_id: frame for frame in chosen.read(out, found)}
    assert found.intrinsics == camera
    assert set(got) == {frame.frame_id for frame in frames}
    for frame in frames:
        assert_same_frame(got[frame.frame_id], frame, chosen.lacks)


# A label set for the tools of others


def blocks(seed: int = 0) -> FrameLabels:
    """All parts and undefined in blocks, noise within; two persons; depth everywhere but in one corner."""
    rng = np.random.default_rng(seed)
    ids = np.array([0, *range(12), 255, 0, 3], np.uint8).reshape(4, 4)
    parts = np.kron(ids, np.ones((6, 8), np.uint8))
    parts[rng.random(parts.shape) < 0.1] = 0
    depth = rng.integers(500, 4500, parts.shape).astype(np.uint16)
    depth[:4, :5] = 0
    persons = (parts > 0).astype(np.uint8)
    persons[20:, 24:] = 2
    confidence = (rng.integers(0, 256, parts.shape) / np.float32(255)).astype(np.float32)
    return FrameLabels(f"{seed:06d}", depth, parts, confidence, "corrected", f"P{seed}", {}, persons)


CAMERA = Intrinsics(32, 24, 30.0, 31.0, 15.5, 11.5)


@pytest.fixture
def labels(tmp_path) -> LabelSet:
    return make(tmp_path / "labels", CAMERA, [blocks(0), blocks(1)])


@pytest.fixture
def export(labels, tmp_path):
    def run(name: str) -> Path:
        out = tmp_path / name
        export_labels(labels, out, name, nothing)
        return out

    return run


def test_pairs_and_clouds_are_recordings_too(export):
    source = open_source(export("pairs"))
    assert source.calibration.depth == CAMERA
    for frame, expected in zip(source, [blocks(0), blocks(1)], strict=True):
        np.testing.assert_array_equal(frame.depth_mm, expected.depth_mm)
    source = open_source(export("pcd") / "000001.pcd")
    np.testing.assert_array_equal(next(iter(source)).depth_mm, blocks(1).depth_mm)
    np.testing.assert_allclose(source.calibration.depth.matrix, CAMERA.matrix, atol=1e-3)


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # pycocotools on NumPy 2
def test_pycocotools_reads_our_masks(export, capsys):
    coco = pytest.importorskip("pycocotools.coco")
    out = export("coco")
    read = coco.COCO(str(out / ANNOTATIONS))
    for number, expected in ((1, blocks(0)), (2, blocks(1))):
        parts = np.zeros(CAMERA.shape, np.uint8)
        for annotation in read.loadAnns(read.getAnnIds(imgIds=[number])):
            mask = read.annToMask(annotation).astype(bool)
            assert mask.sum() == annotation["area"]
            assert read.annToRLE(annotation)["size"] == list(CAMERA.shape)
            v, u = np.nonzero(mask)
            assert annotation["bbox"] == [u.min(), v.min(), np.ptp(u) + 1, np.ptp(v) + 1]
            if annotation["category_id"] != 100:
                parts[mask] = annotation["category_id"]
        np.testing.assert_array_equal(parts, expected.parts)
        image = cv2.imread(str(out / "images" / read.loadImgs(number)[0]["file_name"]), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(image, expected.depth_mm)
    names = {category["id"]: category["name"] for category in read.loadCats(read.getCatIds())}
    assert all(names[part.id] == part.name for part in PARTS[1:])


@given(st.lists(st.booleans(), min_size=1, max_size=80), st.integers(0, 3))
@law
def test_run_lengths_are_those_of_pycocotools(bits, zeros):
    mask = pytest.importorskip("pycocotools.mask")
    flat = np.array([*bits, *[False] * (400 * zeros)], bool)
    runs = runs_of(flat)
    theirs = mask.encode(np.asfortranarray(flat[:, None].astype(np.uint8)))["counts"].decode()
    assert rle_to_string(runs) == theirs
    assert rle_from_string(theirs) == runs
    np.testing.assert_array_equal(mask_from_runs(runs, len(flat)), flat)


@pytest.mark.parametrize("name", ["pcd", "ply"])
def test_open3d_reads_our_clouds(export, name):
    o3d = pytest.importorskip("open3d")
    expected = blocks(0)
    cloud = o3d.t.io.read_point_cloud(
        str(export(name) / f"000000.{name}"), remove_nan_points=False, remove_infinite_points=False
    )
    np.testing.assert_array_equal(cloud.point["label"].numpy().ravel(), expected.parts.ravel())
    metres = np.where(expected.depth_mm > 0, expected.depth_mm / 1000, np.nan)
    np.testing.assert_array_equal(cloud.point.positions.numpy(), unproject(CAMERA, metres).reshape(-1, 3))
    np.testing.assert_array_equal(cloud.point["confidence"].numpy().ravel(), expected.confidence.ravel())
    colors = np.array([PARTS[i].rgb if i < 12 else (128, 128, 128) for i in expected.parts.ravel()])
    np.testing.assert_array_equal(cloud.point.colors.numpy(), colors)


def test_datasets_reads_our_parquet(export, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_DATASETS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("HF_DATASETS_OFFLINE", "1")
    datasets = pytest.importorskip("datasets")
    file = next((export("parquet") / "data").iterdir())
    assert file.name == "train-00000-of-00001.parquet"
    rows = datasets.Dataset.from_parquet(str(file), cache_dir=str(tmp_path / "cache"), keep_in_memory=True)
    assert isinstance(rows.features["image"], datasets.Image)
    assert rows["subject"][:] == ["P0", "P1"]
    for row, expected in zip(rows, [blocks(0), blocks(1)], strict=True):
        np.testing.assert_array_equal(np.array(row["image"]).astype(np.uint16), expected.depth_mm)
        np.testing.assert_array_equal(np.array(row["label"]), expected.parts)
        np.testing.assert_array_equal(np.array(row["persons"]), expected.persons)


def test_semantic_kitti_is_read_as_its_own_tools_do(export):
    yaml = pytest.importorskip("yaml")
    out, expected = export("semantic-kitti"), blocks(0)
    # As semantic-kitti-api's laserscan.py opens scans and labels.
    scan = np.fromfile(out / "sequences/00/velodyne/000000.bin", np.float32).reshape(-1, 4)
    label = np.fromfile(out / "sequences/00/labels/000000.label", np.uint32)
    assert len(scan) == len(label)
    seen = expected.depth_mm > 0
    labelled = expected.parts[seen | (expected.parts > 0)]
    np.testing.assert_array_equal(np.sort(label & 0xFFFF), np.sort(labelled))
    np.testing.assert_allclose(scan[:, 0].max(), expected.depth_mm.max() / 1000)
    config = yaml.safe_load((out / "semantic-kitti.yaml").read_text())
    assert config["labels"][3] == "left_upper_arm"
    learned, back = config["learning_map"], config["learning_map_inv"]
    assert {back[learned[i]] for i in config["labels"]} == set(config["labels"])


# CVAT


def test_cvat_masks_and_polygons_of_others_are_read(export, tmp_path):
    """Also of many corners and many masks; a name leads nowhere outside."""
    out = export("cvat")
    (out / XML).write_text(
        '<?xml version="1.0" encoding="utf-8"?><annotations><version>1.1</version>'
        '<image id="7" name="sub/000001.png" width="32" height="24">'
        '<polygon label="torso" points="4.0,3.0;10.0,3.0;10.0,9.0;4.0,9.0" z_order="0"></polygon>'
        '<mask label="head" rle="1, 2, 1" left="5" top="4" width="2" height="2" z_order="1"/>'
        '<box label="x" xtl="1"/><tag label="y"/></image></annotations>'
    )
    parts = import_labels(out, tmp_path / "back", nothing)[0].read("000001").parts
    assert parts[4:6, 5:7].tolist() == [[2, 1], [1, 2]]
    assert set(np.unique(parts[4:8, 5:9])) == {1, 2} and (parts > 0).sum() in range(36, 50)
    round_ = [(16 + 9 * np.cos(a), 12 + 9 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 12_000)]
    polygon = f'<polygon label="torso" points="{";".join(f"{x:.4f},{y:.4f}" for x, y in round_)}"/>'
    dot = '<mask label="head" rle="0,1" left="16" top="12" width="1" height="1" z_order="1"/>'
    (out / XML).write_text(xml(polygon + dot * 2500, "../../000000.png"))
    parts = import_labels(out, tmp_path / "many", nothing)[0].read("000000").parts
    assert parts[12, 16] == 1 and (parts == 2).sum() in range(230, 290)


BOMB = '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


def xml(shape: str, name: str = "000000.png") -> str:
    return f'<annotations><image name="{name}">{shape}</image></annotations>'


def mask(label: str, rle: str, left: int, width: int, height: int = 1) -> str:
    return xml(f'<mask label="{label}" rle="{rle}" left="{left}" top="0" width="{width}" height="{height}"/>')


EVIL_XML = {
    "empty dtd": "<!DOCTYPE x>" + xml(""),
    "bomb": BOMB + "]><annotations>&i;</annotations>",
    "external": '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/hostname">]>' + xml("", "&e;"),
    "external dtd": '<!DOCTYPE x SYSTEM "http://127.0.0.1:1/x.dtd"><annotations/>',
    "deep": "<a>" * 100_000,
    "cut": "<annotations><image",
    "other": "<html></html>",
    "nul": xml("", "a&#x41;.png"),
    "label": mask("tail", "0,1", 0, 1),
    "huge": mask("head", "0,999999999999", 0, 10**6, 10**6),
    "negative": mask("head", "-1,2", 0, 1),
    "nan": xml('<polygon label="head" points="nan,0;1,1;2,2"/>'),
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize("name", EVIL_XML)
def test_evil_xml_is_refused(export, tmp_path, name, encoding):
    out = export("cvat")
    before = tree(tmp_path)
    (out / XML).write_bytes(EVIL_XML[name].encode(encoding))
    with pytest.raises(CloudError, match="document type" if "DOCTYPE" in EVIL_XML[name] else None) as error:
        import_labels(out, tmp_path / "back", nothing)
    assert "hostname" not in str(error.value).replace(str(tmp_path), "")
    assert set(tree(tmp_path)) == set(before)


# The command


@pytest.mark.parametrize("name", FORMATS)
def test_export_and_import_by_command(annotate_cloud, labels, tmp_path, name):
    done = annotate_cloud("export", labels.path, tmp_path / "out", "--format", name, "--json")
    assert (done.code, done.result["frames"], done.result["left_out"]) == (0, 2, list(FORMATS[name].lacks))
    assert all(f"{what}" in done.err for what in FORMATS[name].lacks)
    done = annotate_cloud("import", tmp_path / "out", tmp_path / "back", "--json")
    assert (done.code, done.result["frames"], done.result["format"]) == (0, 2, name)
    assert_same_frame(LabelSet.open(tmp_path / "back").read("000001"), blocks(1), FORMATS[name].lacks)


def test_nothing_is_overwritten_unasked(annotate_cloud, labels, tmp_path):
    out = tmp_path / "out"
    assert annotate_cloud("export", labels.path, out, "--format", "pairs").code == 0
    before = tree(tmp_path)
    assert_refused(annotate_cloud("export", labels.path, out, "--format", "coco"), out, "--overwrite")
    assert_refused(annotate_cloud("export", labels.path, labels.path, "--format", "coco"), "--overwrite")
    into_itself = annotate_cloud("export", labels.path, tmp_path, "--format", "coco", "--overwrite")
    assert_refused(into_itself, "holds the input")
    assert_refused(annotate_cloud("import", out, labels.path), "--overwrite")
    assert_refused(annotate_cloud("export", labels.path, out, "--format", "yolo"), "yolo", "semantic-kitti")
    assert_refused(
        annotate_cloud("import", labels.path / "frames", tmp_path / "x"), "no known format", ".mcap"
    )
    assert_refused(annotate_cloud("import", labels.path, tmp_path / "x"), "is a label set already")
    assert tree(tmp_path) == before
    assert annotate_cloud("export", labels.path, out, "--format", "coco", "--overwrite").code == 0
    assert recognise(out) == "coco"
    assert annotate_cloud("import", out, tmp_path / "back").code == 0
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    assert_refused(
        annotate_cloud("export", labels.path, tmp_path / "mine", "--format", "pairs", "--overwrite"),
        "not made",
    )
    assert (tmp_path / "mine" / "thesis.txt").is_file()
    (tmp_path / "back" / JOURNAL).write_text("{}\n")
    assert_refused(annotate_cloud("import", out, tmp_path / "back", "--overwrite"), "corrections")


def test_a_failed_export_leaves_nothing(labels, tmp_path):
    (labels.path / "frames" / "000001.depth.png").write_bytes(b"")
    before = tree(tmp_path)
    for name in FORMATS:
        with pytest.raises(FormatError, match="000001"):
            export_labels(labels, tmp_path / "out", name, nothing)
    assert tree(tmp_path) == before


@pytest.mark.parametrize("name", FORMATS)
def test_a_failed_import_leaves_nothing(export, tmp_path, name):
    out = export(name)
    files = [path for path in out.rglob("*") if path.is_file() and path.name != COMPANION]
    largest = max(files, key=lambda path: path.stat().st_size)
    largest.write_bytes(largest.read_bytes()[: largest.stat().st_size // 2])
    before = tree(tmp_path)
    with pytest.raises(CloudError):
        import_labels(out, tmp_path / "back", nothing)
    assert tree(tmp_path) == before


@pytest.mark.parametrize(
    "spoil",
    [
        {"schema": 2},
        {"frames": []},
        {"frames": {"000000": 3}},
        {"frames": {"000000": {"subject": 3}}},
        {"frames": {"000000": {"status": "perfect"}}},
        {"frames": {"000000": {"notes": "x"}}},
        {"intrinsics": {"width": 10**9}},
        {"intrinsics": {"fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0, "width": 16.0, "height": 12}},
        {"intrinsics": None},
    ],
)
def test_a_spoilt_companion_is_refused(export, tmp_path, spoil):
    out = export("pairs")
    content = json.loads((out / COMPANION).read_text())
    (out / COMPANION).write_text(json.dumps({**content, **spoil}))
    with pytest.raises(FormatError, match=f"{out}|frame 000000"):
        import_labels(out, tmp_path / "back", nothing)


def test_folders_of_others_need_only_intrinsics(export, tmp_path):
    out = export("mmseg")
    assert {f.name for f in (out / "img_dir").iterdir()} == {f.name for f in (out / "ann_dir").iterdir()}
    assert json.loads((out / "metainfo.json").read_text())["classes"][7] == "hip"
    (out / COMPANION).unlink()
    for folder in ("img_dir", "ann_dir"):
        (out / folder / "train").mkdir()
        (out / folder / "000001.png").rename(out / folder / "train" / "000001.png")
        (out / folder / "000000.png").unlink()
    back, *_ = import_labels(out, tmp_path / "back", nothing)
    expected = replace(blocks(1), subject="", status="auto")
    assert_same_frame(back.read("000001"), expected, ("persons", "confidence"))
    (out / "intrinsics.json").unlink()
    with pytest.raises(CloudError, match=r"intrinsics\.json"):
        import_labels(out, tmp_path / "other", nothing)


def test_coco_with_uncompressed_runs_is_read_and_equal_names_are_refused(export, tmp_path):
    out = export("coco")
    content = json.loads((out / ANNOTATIONS).read_text())
    for annotation in content["annotations"]:
        annotation["segmentation"]["counts"] = rle_from_string(annotation["segmentation"]["counts"])
    (out / ANNOTATIONS).write_text(json.dumps(content))
    back, *_ = import_labels(out, tmp_path / "back", nothing)
    np.testing.assert_array_equal(back.read("000000").parts, blocks(0).parts)
    content["images"][1]["file_name"] = content["images"][0]["file_name"]
    (out / ANNOTATIONS).write_text(json.dumps(content))
    with pytest.raises(FormatError, match="two images are called"):
        import_labels(out, tmp_path / "more", nothing)


# Bounds


def largest_part(out: Path, name: str) -> int:
    """Bytes of the part of an export that has a bound."""
    if name == "pcd":
        return (out / "000000.pcd").read_bytes().index(b"DATA binary\n") + len(b"DATA binary\n")
    if name == "parquet":
        pq = pytest.importorskip("pyarrow.parquet")
        return pq.read_metadata(next((out / "data").iterdir())).row_group(0).total_byte_size
    return max(path.stat().st_size for path in out.iterdir())


@pytest.mark.parametrize(
    ("name", "modules", "bound", "says"),
    [
        ("pcd", [records], "MAX_HEADER_BYTES", "its header does not end"),
        ("parquet", [parquet_format], "MAX_GROUP_BYTES", "row group"),
        ("coco", [companion_format, coco_format], "MAX_TEXT_BYTES", "is larger than"),
        ("cvat", [companion_format, cvat_format], "MAX_TEXT_BYTES", "is larger than"),
    ],
)
def test_a_part_as_large_as_the_bound_is_read_and_a_larger_one_refused(
    export, tmp_path, monkeypatch, name, modules, bound, says
):
    out = export(name)
    size = largest_part(out, name)
    for less, folder in ((0, "back"), (1, "more")):
        for module in modules:
            monkeypatch.setattr(module, bound, size - less)
        if not less:
            assert len(import_labels(out, tmp_path / folder, nothing)[0]) == 2
            continue
        with pytest.raises(FormatError, match=says):
            import_labels(out, tmp_path / folder, nothing)


def test_parquet_of_others_needs_no_paths_and_may_number_its_rows(tmp_path):
    pa = pytest.importorskip("pyarrow")
    row = parquet_format._row(blocks(0))
    pictures = {n: None if row[n] is None else {"bytes": row[n]["bytes"]} for n in parquet_format.IMAGES}
    schema = parquet_format._schema(CAMERA)
    table = pa.Table.from_pylist([{**row, **pictures, "id": 7}]).replace_schema_metadata(schema.metadata)
    pa.parquet.write_table(table, tmp_path / "train.parquet")
    chosen = FORMATS["parquet"]
    frames = chosen.read(tmp_path, chosen.companion(tmp_path))
    assert_same_frame(next(frames), replace(blocks(0), frame_id="7"))
