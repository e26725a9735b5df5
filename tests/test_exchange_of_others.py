"""Labels of other programs are read right, or the omissions are named."""

import json
import shutil
from zipfile import ZipFile, ZipInfo

import cv2
import numpy as np
import pytest
from conftest import assert_refused

from annotate.exchange.annotated_images import frame_ids
from annotate.exchange.formats import Declared, import_labels
from annotate.labelset.label_set import LabelSet
from annotate.parts import PART_ID
from sensors.errors import CloudError, FormatError

H, W = 48, 64
CAMERA = {"fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 23.5, "width": W, "height": H}
HEAD = np.zeros((H, W), np.uint8)
HEAD[5:15, 20:50] = 1
FORWARD = [[20, 5], [50, 5], [50, 15], [20, 15]]


def nothing(_: int) -> None:
    pass


def taken(source, out, **options):
    return import_labels(source, out, nothing, Declared(**options))


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


NAMES = [
    # name in the file, image, annotation file
    ("000000.png", "images/000000.png", "annotations/instances_default.json"),  # CVAT
    ("a/000000.png", "images/a/000000.png", "annotations/instances_train.json"),
    ("images\\000000.png", "images/000000.png", "annotations.json"),
    ("C:\\data\\000000.png", "000000.png", "_annotations.coco.json"),
    ("/home/x/000000.png", "images/000000.png", "result.json"),  # Label Studio
    ("000000.png", "data/000000.png", "labels.json"),  # FiftyOne
    ("000000.png", "JPEGImages/000000.png", "dataset.json"),  # labelme2coco
    ("000000.png", "images/000000.png", "my export.json"),
    ("000000.png", "train2017/000000.png", "annotations/instances_train2017.json"),  # COCO
    ("000000.png", "train/000000.png", "train/_annotations.coco.json"),  # Roboflow
    ("Bän k 1.png", "images/Bän k 1.png", "annotations.json"),
    ("B%C3%A4n%20k%201.png", "images/Bän k 1.png", "annotations.json"),
    ("Ba\u0308n k 1.png", "images/Bän k 1.png", "annotations.json"),
]


@pytest.mark.parametrize(("name", "image", "annotations"), NAMES)
def test_names_and_places_of_other_programs(coco, tmp_path, name, image, annotations):
    source = coco(name, image=image, annotations=annotations)
    for given in (source, source / annotations):
        found = taken(given, tmp_path / f"labels-{given.stem}", intrinsics=source / "intrinsics.json")
        assert (found.format, found.remarks) == ("coco", ())
        assert found.labels.frame_ids == ["Ban_k_1" if "k" in name and "home" not in name else "000000"]
        np.testing.assert_array_equal(found.labels.parts(found.labels.frame_ids[0]), HEAD * PART_ID["head"])


@pytest.mark.parametrize(
    ("fields", "remarks"),
    [
        (
            {
                "images": [{"id": "x", "file_name": "000000.png"}],
                "annotation": {"image_id": "x", "category_id": "7"},
                "categories": [{"id": "7", "name": " HEAD"}, {"id": 8, "name": "Left upper-arm"}],
            },
            (),
        ),
        (
            {"annotation": {"image_id": 1.0}, "more": [{"id": 2, "image_id": 9, "category_id": 7}]},
            ("annotations of images that the file does not list are not read (1)",),
        ),
    ],
)
def test_ids_may_be_texts_or_floats_and_parts_have_any_case(coco, tmp_path, fields, remarks):
    found = taken(coco(**fields), tmp_path / "labels")
    np.testing.assert_array_equal(found.labels.parts("000000"), HEAD)
    assert found.remarks == remarks


def test_names_that_meet_keep_their_folders_and_never_lead_outside(coco, tmp_path):
    coco("a/1.png", annotations="annotations/instances_train.json")
    source = coco("b/1.png", annotations="annotations/instances_val.json")
    assert taken(source, tmp_path / "labels").labels.frame_ids == ["a_1", "b_1"]
    alone = taken(source / "annotations/instances_val.json", tmp_path / "alone")
    assert alone.labels.frame_ids == ["1"]
    for name in ("../../etc/passwd.png", "/etc/passwd.png", "a/../../passwd.png"):
        assert frame_ids([name]) == ["passwd"]
    with pytest.raises(FormatError):
        frame_ids(["a/.."])


def test_archives_are_read_as_their_folder(coco, tmp_path):
    source = coco(annotations="annotations/instances_default.json", intrinsics=False)
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps(CAMERA))
    for number, (top, slash) in enumerate([("", "/"), ("task/", "/"), ("", "\\"), ("a/b c/", "\\")]):
        archive = tmp_path / f"{number}.zip"
        with ZipFile(archive, "w") as file:
            for path in source.rglob("*.*"):
                entry = ZipInfo("x")
                entry.filename = (top + path.relative_to(source).as_posix()).replace("/", slash)
                file.writestr(entry, path.read_bytes())
        labels = taken(archive, tmp_path / f"labels-{number}", intrinsics=camera).labels
        np.testing.assert_array_equal(labels.parts("000000"), HEAD)


def test_the_remedy_for_absent_intrinsics_works(coco, tmp_path, annotate_cloud):
    source, camera, out = coco(intrinsics=False), tmp_path / "camera.json", tmp_path / "labels"
    camera.write_text(json.dumps(CAMERA))
    refused = annotate_cloud("import", source, out)
    assert refused.code == 1 and "depth camera (--intrinsics)" in refused.err and not out.exists()
    assert annotate_cloud("import", source, out, "--intrinsics", camera).code == 0
    assert LabelSet.open(out).frame_ids == ["000000"]


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
    assert_refused(annotate_cloud("import", source, tmp_path / "labels"), "has a body part", "head")
    assert not (tmp_path / "labels").exists()


def test_coloured_pictures_take_their_depth_from_the_folder_beside(coco, tmp_path):
    source = coco("shot.jpg")
    with pytest.raises(FormatError, match=r"shot\.jpg is not a depth image.*depth"):
        taken(source, tmp_path / "labels")
    (source / "depth").mkdir()
    cv2.imwrite(str(source / "depth" / "shot.png"), np.full((H, W), 1500, np.uint16))
    labels = taken(source, tmp_path / "labels").labels
    assert (labels.read("shot").depth_mm == 1500).all()
    (source / "images" / "shot.jpg").unlink()
    (source / "depth").rename(source / "other")
    with pytest.raises(FormatError, match=r"neither in images/ nor in depth/"):
        taken(source, tmp_path / "more")


def test_an_image_in_two_folders_is_ambiguous(coco, tmp_path):
    source = coco(image="data/000000.png")
    (source / "other").mkdir()
    shutil.copy(source / "data/000000.png", source / "other")
    with pytest.raises(FormatError, match=r"two images are called '000000\.png'; put the right ones into de"):
        taken(source, tmp_path / "labels")


def test_a_depth_image_without_its_label_is_counted(tmp_path):
    for folder, kind in (("depth", np.uint16), ("label", np.uint8)):
        (tmp_path / "pairs" / folder).mkdir(parents=True)
        for name in ("Bän k", "1"):
            cv2.imwrite(str(tmp_path / "pairs" / folder / f"{name}.png"), np.full((H, W), 1, kind))
    (tmp_path / "pairs" / "intrinsics.json").write_text(json.dumps(CAMERA))
    (tmp_path / "pairs" / "label" / "1.png").unlink()
    labels, _, remarks = taken(tmp_path / "pairs", tmp_path / "labels")
    assert labels.frame_ids == ["Ban_k"]
    assert remarks == ("images in depth/ without a label image in label/ are left out (1)",)


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


RING = HEAD.copy()
RING[8:12, 30:40] = 0
SQUARE = [x for corner in FORWARD for x in corner]


@pytest.mark.parametrize(
    ("drawn", "pixels"),
    [
        ([SQUARE], HEAD),
        (SQUARE, HEAD),
        ([FORWARD], HEAD),
        ([[], [20, 5, 50, 5], SQUARE], HEAD),
        ([[*SQUARE, 20, 5, 30, 8, 30, 12, 40, 12, 40, 8, 30, 8, 20, 5]], RING),
        ([[-70.5, -9, 500, -9, 500, 99, -70.5, 99]], np.ones((H, W), np.uint8)),
    ],
)
def test_polygons_hold_the_pixels_whose_centres_lie_in_them(coco, tmp_path, drawn, pixels):
    """Also one without the list around it, in pairs, beside lines, with a hole, and beyond the image."""
    labels = taken(coco(annotation={"segmentation": drawn}), tmp_path / "labels").labels
    np.testing.assert_array_equal(labels.parts("000000"), pixels)


def cvat_of(folder, shape, size=(W, H), file="annotations.xml", around="image"):
    (folder / "images").mkdir(parents=True)
    cv2.imwrite(str(folder / "images/000000.png"), np.full((H, W), 2000, np.uint16))
    (folder / "intrinsics.json").write_text(json.dumps(CAMERA))
    place = f'name="000000.png" width="{size[0]}" height="{size[1]}"'
    (folder / file).write_text(f'<annotations><{around} id="0" {place}>{shape}</{around}></annotations>')
    return folder


def cvat_mask(left, top, width, height):
    rle = f'rle="0, {width * height}"'
    return f'<mask label="head" {rle} left="{left}" top="{top}" width="{width}" height="{height}"></mask>'


@pytest.mark.parametrize("place", [(50, 5, 30, 10), (-5, -3, 30, 10), (-5, -5, 200, 100), (70, 5, 3, 3)])
def test_masks_that_reach_outside_are_cut_off(tmp_path, place):
    left, top, width, height = place
    source = cvat_of(tmp_path / "theirs", cvat_mask(*place) + cvat_mask(0, 0, 1, 1))
    labels, _, remarks = taken(source, tmp_path / "labels")
    expected = np.zeros((H, W), np.uint8)
    expected[max(0, top) : max(0, top + height), max(0, left) : max(0, left + width)] = expected[0, 0] = 1
    np.testing.assert_array_equal(labels.parts("000000"), expected)
    assert remarks == ("masks reach outside their image; the part inside is read (1)",)


def test_cvats_files_of_any_name_float_places_and_open_ends(tmp_path):
    shapes = [
        cvat_mask("20.0", "5.0", 30, 10),
        '<polygon label="head" points="20,5;50,5;50,15;20,15;"></polygon>',
    ]
    for number, shape in enumerate(shapes):
        source = cvat_of(tmp_path / f"theirs-{number}", shape, file="job 1.xml")
        labels = taken(source / "job 1.xml", tmp_path / f"labels-{number}").labels
        np.testing.assert_array_equal(labels.parts("000000"), HEAD)


def test_tracks_and_images_of_another_size_are_refused(coco, tmp_path):
    size = "drawn on an image of 128x96, its depth image is 64x48; annotate"
    for name, options, why in [
        ("track", {"around": "track"}, "holds tracks of a video; export it as 'CVAT for images 1.1'"),
        ("size", {"size": (2 * W, 2 * H)}, size),
    ]:
        with pytest.raises(FormatError, match=why):
            taken(cvat_of(tmp_path / name, cvat_mask(0, 0, 2, 2), **options), tmp_path / "labels")
    image = {"id": 1, "file_name": "000000.png", "width": 2 * W, "height": 2 * H}
    with pytest.raises(FormatError, match=size):
        taken(coco(images=[image], annotation={"segmentation": [SQUARE]}), tmp_path / "labels")


def test_archives_that_cannot_be_unpacked_are_named(tmp_path):
    def archive(*names):
        with ZipFile(tmp_path / "x.zip", "w") as file:
            for name in names:
                file.writestr(name, "{}")
        return tmp_path / "x.zip"

    for names, why in [
        (["a.json", "a.json/b"], r"x\.zip cannot be unpacked \(Not a directory\); unpack it yourself"),
        (["a" * 300], r"x\.zip cannot be unpacked \(File name too long\)"),
        (["annotations.json"], r"x\.zip has neither annotate-cloud\.json nor intrinsics\.json; give a file"),
        (["../escaped.txt", "/escaped.txt"], "no known format"),
    ]:
        with pytest.raises(CloudError, match=why):
            taken(archive(*names), tmp_path / "labels")
    assert not list(tmp_path.rglob("escaped.txt"))
    content = bytearray(archive("annotations.json").read_bytes())
    content[content.index(b"PK\1\2") + 8] |= 1  # the flag of an encrypted entry
    for data, why in ((content, "is encrypted; unpack it"), (content[:-30], r"no known format|be unpacked")):
        (tmp_path / "x.zip").write_bytes(data)
        with pytest.raises(FormatError, match=why):
            taken(tmp_path / "x.zip", tmp_path / "labels")
