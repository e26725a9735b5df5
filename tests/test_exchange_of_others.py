"""Labels as other programs lay them out and write them: read right, or what is left out is named."""

import json
import shutil
from zipfile import ZipFile

import cv2
import numpy as np
import pytest
from conftest import assert_refused

from annotate.exchange.formats import import_labels
from annotate.exchange.image_names import frame_ids
from annotate.labelset.store import LabelSet
from annotate.parts import PART_ID
from sensors.errors import FormatError

H, W = 48, 64
CAMERA = {"fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 23.5, "width": W, "height": H}
HEAD = np.zeros((H, W), np.uint8)
HEAD[5:15, 20:50] = 1
FORWARD = [[20, 5], [50, 5], [50, 15], [20, 15]]


def nothing(_: int) -> None:
    pass


def taken(source, out, **options):
    return import_labels(source, out, nothing, **options)


@pytest.fixture
def coco(tmp_path):
    """Write a folder: annotations by pycocotools, images by OpenCV, at places that programs give them."""
    mask = pytest.importorskip("pycocotools.mask")

    def write(name="000000.png", *, image=None, annotations="annotations.json", intrinsics=True, **fields):
        folder = tmp_path / "theirs"
        file = folder / (image or f"images/{name}")
        file.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(file), np.full((H, W), 2000, np.uint16))
        runs = mask.encode(np.asfortranarray(HEAD))
        annotation = {
            "id": 1, "image_id": 1, "category_id": 7, "iscrowd": 0, "area": int(mask.area(runs)),
            "bbox": mask.toBbox(runs).tolist(), "segmentation": {**runs, "counts": runs["counts"].decode()},
        }  # fmt: skip
        content = {
            "images": [{"id": 1, "file_name": name, "width": W, "height": H}],
            "categories": [{"id": 7, "name": "head"}],
            "annotations": [annotation | fields.pop("annotation", {}), *fields.pop("more", [])],
        }
        (folder / annotations).parent.mkdir(exist_ok=True)
        (folder / annotations).write_text(json.dumps(content | fields))
        if intrinsics:
            (folder / "intrinsics.json").write_text(json.dumps(CAMERA))
        return folder

    return write


def test_cvats_layout_folders_and_backslashes_in_names(coco, tmp_path):
    for number, (name, image, annotations) in enumerate(
        [
            ("000000.png", None, "annotations/instances_default.json"),
            ("a/000000.png", None, "annotations/instances_train.json"),
            ("images\\000000.png", "images/000000.png", "annotations.json"),
            ("C:\\data\\000000.png", "000000.png", "_annotations.coco.json"),
            ("/home/x/000000.png", "images/000000.png", "result.json"),
        ]
    ):
        source = coco(name, image=image, annotations=annotations)
        labels, format_, remarks = taken(source, tmp_path / f"labels-{number}")
        assert (format_, remarks, labels.frame_ids) == ("coco", (), ["000000"])
        np.testing.assert_array_equal(labels.parts("000000"), HEAD * PART_ID["head"])
        shutil.rmtree(source)


def test_subsets_are_one_set_and_names_that_meet_keep_their_folders(coco, tmp_path):
    coco("a/1.png", annotations="annotations/instances_train.json")
    source = coco("b/1.png", annotations="annotations/instances_val.json")
    assert taken(source, tmp_path / "labels").labels.frame_ids == ["a_1", "b_1"]


def test_ids_may_be_texts(coco, tmp_path):
    images = [{"id": "x", "file_name": "000000.png"}]
    annotation = {"image_id": "x", "category_id": "7"}
    source = coco(images=images, annotation=annotation, categories=[{"id": "7", "name": "head"}])
    np.testing.assert_array_equal(taken(source, tmp_path / "labels").labels.parts("000000"), HEAD)


def test_archives_and_annotation_files_are_read_as_their_folder(coco, tmp_path):
    source = coco(annotations="annotations/instances_default.json", intrinsics=False)
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps(CAMERA))
    for number, top in enumerate(("", "task/")):
        archive = tmp_path / f"{number}.zip"
        with ZipFile(archive, "w") as file:
            for path in source.rglob("*.*"):
                file.write(path, top + str(path.relative_to(source)))
        labels = taken(archive, tmp_path / f"labels-{number}", intrinsics=camera).labels
        np.testing.assert_array_equal(labels.parts("000000"), HEAD)
    file = source / "annotations" / "instances_default.json"
    assert len(taken(file, tmp_path / "by-file", intrinsics=camera).labels) == 1


def test_the_remedy_for_absent_intrinsics_works(coco, tmp_path, annotate_cloud):
    source, camera, out = coco(intrinsics=False), tmp_path / "camera.json", tmp_path / "labels"
    camera.write_text(json.dumps(CAMERA))
    refused = annotate_cloud("import", source, out)
    assert refused.code == 1 and "give --intrinsics FILE" in refused.err and not out.exists()
    assert annotate_cloud("import", source, out, "--intrinsics", camera).code == 0
    assert LabelSet.open(out).frame_ids == ["000000"]


def test_an_archive_writes_nothing_outside_and_a_damaged_one_is_named(tmp_path):
    archive = tmp_path / "evil.zip"
    with ZipFile(archive, "w") as file:
        file.writestr("../escaped.txt", "x")
        file.writestr("/escaped.txt", "x")
    with pytest.raises(FormatError, match="no known format"):
        taken(archive, tmp_path / "labels")
    assert not list(tmp_path.rglob("escaped.txt"))
    archive.write_bytes(archive.read_bytes()[:-30])
    with pytest.raises(FormatError, match=r"no known format|cannot be unpacked"):
        taken(archive, tmp_path / "labels")


@pytest.mark.filterwarnings("ignore:__array__:DeprecationWarning")  # of pycocotools with NumPy 2
def test_polygons_are_filled_as_pycocotools_fills_them(coco, tmp_path):
    from pycocotools import mask

    rng = np.random.default_rng(0)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 9))
    corners = np.stack([32 + 20 * np.cos(angles), 24 + 15 * np.sin(angles)], 1)
    polygons = [corners.ravel().tolist(), [2, 2, 9, 2, 9, 9, 2, 9]]
    labels, _, remarks = taken(coco(annotation={"segmentation": polygons}), tmp_path / "labels")
    theirs = mask.decode(mask.merge(mask.frPyObjects(polygons, H, W))) > 0
    own = labels.parts("000000") == PART_ID["head"]
    border = cv2.dilate(theirs.astype(np.uint8), np.ones((3, 3))) != cv2.erode(
        theirs.astype(np.uint8), np.ones((3, 3))
    )
    assert (own == theirs)[~border].all()
    assert "approximate" in remarks[0]


def test_runs_counted_row_by_row_are_read_as_such_and_doubtful_boxes_named(coco, tmp_path):
    flat = np.flatnonzero(np.diff(np.concatenate([[0], HEAD.ravel(), [0]])))
    counts = np.diff([0, *flat.tolist(), H * W]).tolist()
    rows = {"segmentation": {"size": [H, W], "counts": counts}}
    labels, _, remarks = taken(coco(annotation=rows), tmp_path / "rows")
    np.testing.assert_array_equal(labels.parts("000000"), HEAD)
    assert "row by row" in remarks[0]
    labels, _, remarks = taken(coco(annotation={"bbox": [0, 0, 4, 4]}), tmp_path / "box")
    np.testing.assert_array_equal(labels.parts("000000"), HEAD)
    assert "do not fit their bbox" in remarks[0]


def test_boxes_and_key_points_are_counted(annotate_cloud, coco, tmp_path):
    more = [{"id": n, "image_id": 1, "category_id": 7, "bbox": [1, 1, 5, 5], "keypoints": []} for n in (2, 3)]
    done = annotate_cloud("import", coco(more=more), tmp_path / "labels")
    assert done.code == 0, done.err
    assert "annotations without a mask (boxes, key points) are not read (2)" in done.err
    xml = f"""<annotations><image id="0" name="000000.png" width="{W}" height="{H}">
        <mask label="head" rle="0, 300" left="20" top="5" width="30" height="10" z_order="0"></mask>
        <box label="torso" xtl="1" ytl="20" xbr="30" ybr="40" z_order="5"></box>
        <ellipse label="torso" cx="20" cy="30" rx="4" ry="4" z_order="5"></ellipse></image></annotations>"""
    source = coco()
    (source / "annotations.json").unlink()
    (source / "annotations.xml").write_text(xml)
    labels, format_, remarks = taken(source, tmp_path / "cvat")
    assert format_ == "cvat"
    assert {
        "shapes of the kind box are not read (1)",
        "shapes of the kind ellipse are not read (1)",
    } == {*remarks}
    np.testing.assert_array_equal(labels.parts("000000"), HEAD)


def test_an_import_that_names_no_part_is_refused(annotate_cloud, coco, tmp_path):
    source = coco(categories=[{"id": 7, "name": "person"}])
    assert_refused(annotate_cloud("import", source, tmp_path / "labels"), "labels no body part", "head")
    assert not (tmp_path / "labels").exists()


def test_coloured_pictures_take_their_depth_from_the_folder_beside(coco, tmp_path):
    source = coco("shot.jpg")
    with pytest.raises(FormatError, match=r"shot\.jpg is no depth image.*depth"):
        taken(source, tmp_path / "labels")
    (source / "depth").mkdir()
    cv2.imwrite(str(source / "depth" / "shot.png"), np.full((H, W), 1500, np.uint16))
    labels = taken(source, tmp_path / "labels").labels
    assert labels.frame_ids == ["shot"]
    assert (labels.read("shot").depth_mm == 1500).all()
    (source / "images" / "shot.jpg").unlink()
    (source / "depth" / "shot.png").unlink()
    with pytest.raises(FormatError, match=r"neither in images/ nor in depth/"):
        taken(source, tmp_path / "more")


def test_a_depth_image_without_its_label_is_counted(tmp_path):
    for folder, kind in (("depth", np.uint16), ("label", np.uint8)):
        (tmp_path / "pairs" / folder).mkdir(parents=True)
        for i in range(2):
            cv2.imwrite(str(tmp_path / "pairs" / folder / f"{i}.png"), np.full((H, W), 1, kind))
    (tmp_path / "pairs" / "intrinsics.json").write_text(json.dumps(CAMERA))
    (tmp_path / "pairs" / "label" / "1.png").unlink()
    labels, _, remarks = taken(tmp_path / "pairs", tmp_path / "labels")
    assert len(labels) == 1
    assert remarks == ("images in depth/ without a label image in label/ are left out (1)",)


@pytest.mark.parametrize("name", ["../../etc/passwd.png", "/etc/passwd.png", "a/../../b.png"])
def test_a_name_leads_nowhere_outside(name):
    assert frame_ids([name])[0] in ("passwd", "b")
    with pytest.raises(FormatError):
        frame_ids(["a/.."])


@pytest.mark.parametrize(
    ("name", "remarks"),
    [
        ("coco_as_cvat_lays_it_out", 0),
        ("coco_backslash_names", 0),
        ("coco_row_major_runs", 1),
        ("cvat_box_beside_mask", 1),
    ],
)
def test_files_of_others(shared_data, tmp_path, name, remarks):
    found = taken(shared_data / "others_files" / name, tmp_path / "labels")
    assert len(found.remarks) == remarks
    np.testing.assert_array_equal(LabelSet.open(tmp_path / "labels").parts("000000"), HEAD)
