"""Label sets of any scheme survive every format; others' class names become parts."""

import json
from dataclasses import replace
from xml.etree.ElementTree import parse

import numpy as np
import pytest
from conftest import assert_refused

from annotate.exchange import coco, cvat, image_pairs, semantic_kitti
from annotate.exchange.formats import FORMATS, Declared, export_labels, import_labels
from annotate.joint_names import JOINT_NAMES
from annotate.labelset.cast_note import cast_of
from annotate.labelset.images import decode_parts, encode_parts
from annotate.labelset.label_set import LabelSet
from annotate.labelset.scheme_note import scheme_note
from annotate.parts import PAPER
from annotate.scheme.scheme import Part, scheme_of
from annotate.scheme.scheme_file import load_scheme, scheme_to_toml
from sensors.errors import FormatError
from tests.helpers.label_sets import CAMERA
from tests.helpers.same_frame import assert_same_frame
from tests.helpers.schemes import WARD, frame_in

HANDS = load_scheme("hands-and-feet")


def nothing(_: int) -> None:
    pass


@pytest.fixture(params=[HANDS, WARD], ids=lambda scheme: scheme.name)
def labels(request, tmp_path) -> LabelSet:
    return made(tmp_path / "labels", request.param)


def made(path, scheme, **info) -> LabelSet:
    labels = LabelSet.create(path, CAMERA, info | scheme_note(scheme))
    for seed in range(2):
        labels.write(frame_in(scheme, seed))
    return labels


def exported(labels: LabelSet, name: str):
    out = labels.path.with_name(f"{labels.path.name}-{name}")
    export_labels(labels, out, name, nothing)
    return out


@pytest.mark.parametrize("name", FORMATS)
def test_parts_and_things_come_back_the_same(labels, name, tmp_path):
    back = import_labels(exported(labels, name), tmp_path / "back", nothing).labels
    assert back.scheme == labels.scheme
    for seed in range(2):
        expected = frame_in(labels.scheme, seed)
        assert_same_frame(back.read(expected.frame_id), expected, FORMATS[name].lacks)


@pytest.mark.parametrize("name", FORMATS)
def test_a_cast_reserved_for_measuring_stays_reserved(tmp_path, name):
    labels = made(tmp_path / "labels", PAPER, cast="judging")
    assert cast_of(import_labels(exported(labels, name), tmp_path / "back", nothing).labels.info) == "judging"


def test_coco_names_parts_and_things(labels):
    content = json.loads((exported(labels, "coco") / coco.ANNOTATIONS).read_text())
    named = {one["id"]: (one["name"], one["supercategory"]) for one in content["categories"]}
    parts = {part.id: (part.name, "thing" if part.is_free else "person") for part in labels.scheme.parts}
    assert named == parts | {255: ("undefined", "person"), 100: ("person", "person")}


def test_coco_has_key_points_where_frames_have_joints(tmp_path):
    pytest.importorskip("pycocotools")
    labels = made(tmp_path / "labels", WARD)
    joints = [[2 * i, i, 1500.0] for i in range(len(JOINT_NAMES))]
    joints[0] = [-3, 0, 1500.0]
    frame = frame_in(WARD)
    labels.write_labels(replace(frame, notes={"bearing": {"joints_px": joints}}))
    content = json.loads((exported(labels, "coco") / coco.ANNOTATIONS).read_text())
    (person,) = (one for one in content["categories"] if "keypoints" in one)
    assert (person["name"], person["keypoints"]) == ("person", [*JOINT_NAMES])
    assert {i for bone in person["skeleton"] for i in bone} <= {*range(1, len(JOINT_NAMES) + 1)}
    (annotation,) = (one for one in content["annotations"] if "keypoints" in one)
    assert annotation["category_id"] == person["id"] and annotation["num_keypoints"] == len(JOINT_NAMES) - 1
    assert annotation["keypoints"][:6] == [0, 0, 0, 2, 1, 2]


def test_a_part_with_the_person_s_category_is_kept_apart(tmp_path):
    parts = [*HANDS.parts, Part(100, "crutch", "Crutch", (255, 255, 0))]
    scheme = scheme_of("crutch", parts)
    labels = made(tmp_path / "labels", scheme)
    back = import_labels(exported(labels, "coco"), tmp_path / "back", nothing).labels
    assert_same_frame(back.read("000000"), frame_in(scheme), ("confidence",))


@pytest.mark.parametrize("name", ["coco", "cvat"])
def test_a_part_called_person_is_refused_in_masks(tmp_path, name):
    scheme = scheme_of("two", [*HANDS.parts, Part(16, "person", "Other person", (255, 255, 0))])
    labels = made(tmp_path / "labels", scheme)
    with pytest.raises(FormatError, match=r"has a part 'person'.*; rename the part"):
        exported(labels, name)
    assert import_labels(exported(labels, "pairs"), tmp_path / "back", nothing).labels.scheme == scheme


def test_cvat_has_the_scheme_s_names_and_colours(labels):
    root = parse(exported(labels, "cvat") / cvat.ANNOTATIONS).getroot()
    colors = {one.findtext("name"): one.findtext("color") for one in root.iter("label")}
    expected = {part.name: "#{:02x}{:02x}{:02x}".format(*part.rgb) for part in labels.scheme.parts}
    assert colors == expected | {"undefined": "#808080", "person": "#808080"}


def test_mmseg_lists_names_and_colours_by_id(labels):
    content = json.loads((exported(labels, "mmseg") / image_pairs.METAINFO).read_text())
    for part in labels.scheme.parts:
        assert content["classes"][part.id] == part.name
        assert tuple(content["palette"][part.id]) == part.rgb
    assert len(set(content["classes"])) == len(content["palette"]) == labels.scheme.n_classes


def test_semantic_kitti_names_all_classes(labels):
    yaml = pytest.importorskip("yaml")
    content = yaml.safe_load((exported(labels, "semantic-kitti") / semantic_kitti.CONFIG).read_text())
    names = {0: "background", 255: "undefined", **{part.id: part.name for part in labels.scheme.parts}}
    assert content["labels"] == names
    assert {i: tuple(c[::-1]) for i, c in content["color_map"].items()} == {
        i: tuple(labels.scheme.palette_rgb()[i].tolist()) for i in names
    }
    learned = content["learning_map"]
    assert learned[255] == 0 and sorted(learned.values()) == [*range(len(names))]
    assert content["learning_map_inv"] == {index: i for i, index in learned.items()}


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_hugging_face_reads_the_names_of_classes(labels, tmp_path):
    datasets = pytest.importorskip("datasets")
    folder = exported(labels, "parquet")
    rows = datasets.load_dataset(str(folder), split="train", cache_dir=str(tmp_path / "cache"))
    label = rows.features["classes"].feature
    present = [label.int2str(i) for i in rows[0]["classes"]]
    assert present == ["background", *(part.name for part in labels.scheme.parts)]


# Labels of other programs

MAP = {"Left Paw": "left_hand", "right-paw": "right_hand", "chair": "wheelchair", "dog": "background"}


@pytest.fixture
def theirs(tmp_path):
    """Write a COCO folder whose categories have other names, without the file of an export."""

    def write(names: dict[str, str]):
        out = exported(made(tmp_path / "own", WARD), "coco")
        (out / "annotate-cloud.json").unlink()
        content = json.loads((out / coco.ANNOTATIONS).read_text())
        for category in content["categories"]:
            category["name"] = names.get(category["name"], category["name"])
        (out / coco.ANNOTATIONS).write_text(json.dumps(content))
        return out

    return write


RENAMED = {"left_hand": "LEFT paw", "right_hand": "Right-Paw", "wheelchair": "Chair", "blanket": "dog"}


@pytest.mark.parametrize("suffix", ["json", "toml"])
def test_others_names_become_parts(theirs, tmp_path, annotate_cloud, suffix):
    file, scheme = tmp_path / f"map.{suffix}", tmp_path / "ward.toml"
    lines = [f"{json.dumps(one)} = {json.dumps(other)}" for one, other in MAP.items()]
    file.write_text(json.dumps(MAP) if suffix == "json" else "\n".join(lines))
    scheme.write_text(scheme_to_toml(WARD))
    out = tmp_path / "back"
    done = annotate_cloud("import", theirs(RENAMED), out, "--map", file, "--scheme", scheme, "--json")
    assert (done.code, done.result["scheme"]) == (0, "ward")
    expected = frame_in(WARD).parts
    np.testing.assert_array_equal(
        LabelSet.open(out).read("000000").parts, np.where(expected == 42, 0, expected)
    )


def test_unknown_names_are_listed_in_one_line(theirs, tmp_path, annotate_cloud):
    done = annotate_cloud("import", theirs(RENAMED), tmp_path / "back")
    assert_refused(done, "'LEFT paw'", "'Right-Paw'", "'Chair'", "'left_foot'", "(--scheme, --map)")
    assert done.err.count("\n") == 1 and not (tmp_path / "back").exists()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ('{"a": "tail"}', "'tail' for 'a', unknown in scheme 'paper'"),
        ('{"a": 3}', "name 'a' has '3'; give a file"),
        ('{"a b": "head", "A-B": "hip"}', "has a name twice"),
        ("{}", "has no names"),
        ("[]", "has no names"),
        ("{", "is not JSON"),
    ],
)
def test_a_wrong_map_gets_one_line(theirs, tmp_path, annotate_cloud, content, says):
    file = tmp_path / "map.json"
    file.write_text(content)
    assert_refused(annotate_cloud("import", theirs({}), tmp_path / "back", "--map", file), says)


def test_masks_of_whole_persons_alone_are_refused(theirs, tmp_path, annotate_cloud):
    folder = theirs({})
    content = json.loads((folder / coco.ANNOTATIONS).read_text())
    content["annotations"] = [one for one in content["annotations"] if one["category_id"] == 100]
    (folder / coco.ANNOTATIONS).write_text(json.dumps(content))
    assert_refused(annotate_cloud("import", folder, tmp_path / "back"), "has a body part", "--map")


def test_a_stated_scheme_is_not_overruled(tmp_path, annotate_cloud):
    out = exported(made(tmp_path / "own", HANDS), "pairs")
    done = annotate_cloud("import", out, tmp_path / "back", "--scheme", "six")
    assert_refused(done, "has scheme 'hands-and-feet'", "leave the scheme out")
    assert annotate_cloud("import", out, tmp_path / "back", "--scheme", "hands-and-feet").code == 0


def test_a_camera_of_one_s_own_leaves_the_scheme(tmp_path):
    out = exported(made(tmp_path / "own", HANDS), "pairs")
    declared = Declared(out / "intrinsics.json")
    assert import_labels(out, tmp_path / "back", nothing, declared).labels.scheme == HANDS


def test_ids_of_others_become_parts(tmp_path):
    out = exported(made(tmp_path / "own", HANDS), "pairs")
    (out / "annotate-cloud.json").unlink()
    declared = Declared(scheme=HANDS, theirs={"12": "left_forearm", "0": "undefined"})
    parts = import_labels(out, tmp_path / "back", nothing, declared).labels.read("000000").parts
    expected = frame_in(HANDS).parts
    table = np.arange(256)
    table[[12, 0]] = 5, 255
    np.testing.assert_array_equal(parts, table[expected])
    with pytest.raises(FormatError, match="the name 'paw', but these label images hold ids"):
        import_labels(out, tmp_path / "more", nothing, Declared(scheme=HANDS, theirs={"paw": "head"}))
    with pytest.raises(FormatError, match="unknown in scheme 'paper'"):
        import_labels(out, tmp_path / "more", nothing)


def test_mmsegmentation_s_own_class_names_are_read(tmp_path):
    out = exported(made(tmp_path / "own", HANDS), "mmseg")
    (out / "annotate-cloud.json").unlink()
    file = out / image_pairs.METAINFO
    content = json.loads(file.read_text())
    swapped = dict(zip(("head", "torso"), ("Torso", "Head"), strict=True))
    file.write_text(json.dumps({"classes": [swapped.get(name, name) for name in content["classes"]]}))
    parts = import_labels(out, tmp_path / "back", nothing, Declared(scheme=HANDS)).labels.read("000000").parts
    expected = frame_in(HANDS).parts
    table = np.arange(256)
    table[[1, 2]] = 2, 1
    np.testing.assert_array_equal(parts, table[expected])
    file.write_text(json.dumps({"classes": ["wall", "floor", "person"]}))
    with pytest.raises(FormatError, match=r"metainfo\.json has names .*'floor', 'person', 'wall'"):
        import_labels(out, tmp_path / "more", nothing, Declared(scheme=HANDS))


def test_a_scheme_of_labels_is_no_option_of_recordings(tmp_path, annotate_cloud):
    done = annotate_cloud("import", tmp_path, tmp_path / "out.mcap", "--scheme", "six")
    assert done.code == 2 and "--scheme, --map and --by-hand are for labels" in " ".join(done.err.split())


def test_label_images_hold_the_colours_of_their_scheme(tmp_path):
    out = exported(made(tmp_path / "own", WARD), "pairs")
    data = (out / "label" / "000000.png").read_bytes()
    assert data == encode_parts(decode_parts(data), WARD) != encode_parts(decode_parts(data))
