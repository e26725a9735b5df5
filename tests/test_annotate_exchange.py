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
from annotate.exchange.coco import ANNOTATIONS
from annotate.exchange.companion import COMPANION, Companion
from annotate.exchange.formats import FORMATS, export_labels, import_labels, recognise
from annotate.frame_labels import FrameLabels
from annotate.labelset.journal import JOURNAL
from annotate.labelset.label_set import LabelSet
from annotate.parts import PARTS
from sensors.errors import CloudError, FormatError
from sensors.importers.clouds import records
from sensors.importers.open_source import open_source
from sensors.rig.camera import Intrinsics, unproject
from sensors.rig.frame import FARTHEST_MM
from tests.helpers.label_sets import CAMERA, blocks, make
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
        depth = (rng.integers(0, FARTHEST_MM + 1, parts.shape) * (rng.random(parts.shape) < 0.7)).astype(
            np.uint16
        )
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
        chosen.write(iter(frames), companion, out)
        companion.save(out)
        assert recognise(out) == name
        found = chosen.companion(out)
        got = {frame.frame_id: frame for frame in chosen.read(out, found)}
    assert found.intrinsics == camera
    assert set(got) == {frame.frame_id for frame in frames}
    for frame in frames:
        assert_same_frame(got[frame.frame_id], frame, chosen.lacks)


# A label set for the tools of others


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


# The command


@pytest.mark.parametrize("name", FORMATS)
def test_export_and_import_by_command(annotate_cloud, labels, tmp_path, name):
    done = annotate_cloud("export", labels.path, tmp_path / "out", "--format", name, "--names", "--json")
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
    schema = parquet_format._schema(Companion(CAMERA))
    table = pa.Table.from_pylist([{**row, **pictures, "id": 7}]).replace_schema_metadata(schema.metadata)
    pa.parquet.write_table(table, tmp_path / "train.parquet")
    chosen = FORMATS["parquet"]
    frames = chosen.read(tmp_path, chosen.companion(tmp_path))
    assert_same_frame(next(frames), replace(blocks(0), frame_id="7"))
