"""COCO: ``annotations.json`` with run-length masks, and the depth images in ``images/``.

Format: cocodataset.org, "Data format"; compressed run lengths: pycocotools' ``maskApi.c`` (``rleToString``),
which is not used because it writes past its memory on a truncated file. A part is a category by its id,
undefined is 255. A person's whole mask is category 100, or 256 where a part has the id 100. It has key points
where the frame's notes have joints.
"""

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from natsort import natsorted

from annotate.array_types import Bool
from annotate.crop import window_of
from annotate.exchange.annotated_images import AnnotatedImage, check_size, read_annotated, write_image
from annotate.exchange.class_names import PERSON, check_names, mask_ids
from annotate.exchange.companion import MAX_TEXT_BYTES, Companion
from annotate.exchange.keypoints import SKELETON, keypoints_of
from annotate.exchange.masks import (
    FEW_CORNERS,
    POLYGONS,
    Mask,
    mask_from_runs,
    masks_of,
    polygon_pixels,
    runs_of,
)
from annotate.frame_labels import FrameLabels
from annotate.scheme.scheme import Scheme
from sensors.errors import FormatError, fault_of
from sensors.files.bounded import read_bounded

ANNOTATIONS = "annotations.json"
ROBOFLOW = "_annotations.coco.json"
LAYOUTS = (
    ANNOTATIONS,
    "annotations/instances_*.json",  # CVAT; its key points lie beside them
    "instances_*.json",
    "annotations/*.json",
    ROBOFLOW,
    f"*/{ROBOFLOW}",
    "*.json",  # Label Studio's result.json, FiftyOne's labels.json, labelme2coco's dataset.json
)
KEYS = (b'"images"', b'"annotations"', b'"categories"')
"""Contents of a COCO file of any name."""
PERSON_CATEGORY = 100  # id of the category of whole persons, where no part has the id
FREE_CATEGORY = 256  # id of that category otherwise; part ids are below
BOX_TOLERANCE_PX = 1.5  # between a stated box and its mask, because programs round differently; untuned


def write_coco(frames: Iterator[FrameLabels], companion: Companion, out: Path) -> None:
    """Write frames as COCO into an empty folder. Raises FormatError as ``mask_ids``."""
    ids = category_ids(companion.scheme)
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for frame in frames:
        height, width = frame.parts.shape
        name = write_image(out, frame)
        images.append({"id": len(images) + 1, "file_name": name, "width": width, "height": height})
        for mask in masks_of(frame):
            own = {"id": len(annotations) + 1, "image_id": len(images), "category_id": ids[mask.name]}
            points = keypoints_of(frame) if (mask.name, mask.person) == (PERSON, 1) else {}
            annotations.append(own | _mask_fields(mask) | points)
    has_joints = any("keypoints" in annotation for annotation in annotations)
    things = companion.scheme.things
    categories = [
        {"id": n, "name": name, "supercategory": "thing" if name in things else PERSON}
        | (SKELETON if has_joints and name == PERSON else {})
        for name, n in ids.items()
    ]
    content = {"images": images, "annotations": annotations, "categories": categories}
    (out / ANNOTATIONS).write_text(json.dumps(content), encoding="ascii")


def category_ids(scheme: Scheme) -> dict[str, int]:
    """Return ids of categories by name. Raises FormatError as ``mask_ids``."""
    ids = mask_ids(scheme)
    return {**ids, PERSON: FREE_CATEGORY if PERSON_CATEGORY in ids.values() else PERSON_CATEGORY}


def _mask_fields(mask: Mask) -> dict[str, Any]:
    extra = {"person": mask.person} if mask.name == PERSON else {}
    return {
        "segmentation": {
            "size": list(mask.pixels.shape),
            "counts": rle_to_string(runs_of(mask.pixels.ravel(order="F"))),
        },
        "area": int(mask.pixels.sum()),
        "bbox": _box(mask.pixels),
        "iscrowd": 0,
        **extra,
    }


def _box(pixels: Bool) -> list[int]:
    rows, columns = window_of(pixels)
    return [columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start]


def annotation_files(source: Path) -> list[Path]:
    """Return the annotation files of a folder, by the first of the known name patterns with a match."""
    for pattern in LAYOUTS:
        files = natsorted(file for file in source.glob(pattern) if file.is_file())
        if pattern == LAYOUTS[-1]:
            files = [f for f in files if all(key in read_bounded(f, MAX_TEXT_BYTES) for key in KEYS)]
        if files:
            return files
    return []


def read_coco(source: Path, companion: Companion) -> Iterator[FrameLabels]:
    """Yield the frames of a folder; masks are run lengths, compressed or not, or polygons. Raises FormatError
    for malformed annotations or images.
    """
    files = [companion.annotations] if companion.annotations else annotation_files(source)
    images = [image for file in files for image in _images(source, file, companion)]
    yield from read_annotated(source, images, companion)


def _images(source: Path, file: Path, companion: Companion) -> list[AnnotatedImage]:
    """Return the images of an annotation file, in its order; ids may be numbers or texts."""
    # Roboflow's splits are folders, each with its annotations and images.
    split = file.parent.name if file.name == ROBOFLOW and file.parent != source else ""
    found: dict[str, AnnotatedImage] = {}
    by_image: dict[str, list[dict[str, Any]]] = {}
    try:
        content = json.loads(read_bounded(file, MAX_TEXT_BYTES))
        categories = {_key(c["id"]): str(c["name"]) for c in content["categories"]}
        for image in content["images"]:
            key, size = _key(image["id"]), (image.get("height"), image.get("width"))
            name = str(PurePosixPath(split) / str(image["file_name"])) if split else str(image["file_name"])
            own = by_image[key] = []
            masks = partial(_masks, own, size, categories, companion)
            found[key] = AnnotatedImage(file, name, masks)
        for annotation in content["annotations"]:
            if _key(annotation["image_id"]) in by_image:
                by_image[_key(annotation["image_id"])].append(annotation)
            else:
                companion.remark("annotations of images that the file does not list are not read")
        drawn = (one for own in by_image.values() for one in own if one.get("segmentation"))
        names = {categories.get(_key(one.get("category_id")), "") for one in drawn} - {""}
    except (KeyError, ValueError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        why = fault_of(error)[:80]
        raise FormatError(f"{file} is not a COCO file ({why}); export it as COCO JSON") from error
    check_names(names, companion.ids_by_name, companion.scheme, file)
    return list(found.values())


def _key(number: object) -> str:
    """Return an id as text; 1.0, as pandas writes whole numbers, becomes "1"."""
    return str(int(number) if isinstance(number, float) and number.is_integer() else number)


def _masks(
    annotations: list[dict[str, Any]],
    size: tuple[object, object],
    categories: dict[str, str],
    companion: Companion,
    shape: tuple[int, int],
) -> Iterator[Mask]:
    """Yield the masks of annotations; boxes and key points without a mask are counted as remarks."""
    for annotation in annotations:
        segmentation, category = annotation.get("segmentation"), _key(annotation["category_id"])
        if category not in categories:
            raise FormatError(f"an annotation has category {category[:40]!r}, which is not listed; add it")
        name = categories[category]
        person = int(annotation.get("person", 1))
        if isinstance(segmentation, dict):
            pixels, remark = _run_pixels(segmentation, annotation.get("bbox"), shape)
            if remark:
                companion.remark(remark)
            yield Mask(name, person, pixels)
            continue
        # Some programs write one polygon without the list around it.
        rings = list(segmentation or [])
        rings = [rings] if rings and isinstance(rings[0], int | float) else rings
        polygons = [np.array(one, np.float64).ravel() for one in rings]
        drawn = [polygon for polygon in polygons if polygon.size >= 6]
        for _ in range(len(polygons) - len(drawn)):
            companion.remark(FEW_CORNERS)
        if not drawn:
            companion.remark("annotations without a mask (boxes, key points) are not read")
            continue
        check_size(size, shape)
        companion.remark(POLYGONS)
        pixels = np.zeros(shape, np.bool_)
        for polygon in drawn:
            if polygon.size % 2:
                raise FormatError(f"a polygon has {polygon.size} coordinates, an odd number; export it again")
            pixels |= polygon_pixels(polygon.reshape(-1, 2), shape)
        yield Mask(name, person, pixels)


def _run_pixels(segmentation: dict[str, Any], box: object, shape: tuple[int, int]) -> tuple[Bool, str]:
    """Return the pixels (h, w) of run lengths, and a remark or "". Raises FormatError where the runs are
    malformed.
    """
    height, width = (int(side) for side in segmentation["size"])
    if (height, width) != shape:
        raise FormatError(f"a mask is {width}x{height} on an image of {shape[1]}x{shape[0]}; export it again")
    counts = segmentation["counts"]
    runs = rle_from_string(counts) if isinstance(counts, str) else [int(n) for n in counts]
    flat = mask_from_runs(runs, height * width)
    by_columns = flat.reshape((height, width), order="F")
    if not flat.any() or _fits(by_columns, box):
        return by_columns, ""
    by_rows = flat.reshape((height, width))
    if _fits(by_rows, box):
        return by_rows, "masks have run lengths row by row, not column by column; bbox shows it"
    return by_columns, "masks do not fit their bbox; their run lengths are read column by column"


def _fits(pixels: Bool, box: object) -> bool:
    if not isinstance(box, list) or len(box) != 4:
        return True
    return bool(np.abs(np.array(box, np.float64) - _box(pixels)).max() <= BOX_TOLERANCE_PX)


def rle_to_string(runs: list[int]) -> str:
    """Return run lengths in COCO's compressed form.

    From the fourth on, each run is stored as the difference to the run two before. A character, counted from
    "0", holds five bits, and a sixth bit that is set while more of the number follows.
    """
    text = []
    for i, run in enumerate(runs):
        value, more = (run - runs[i - 2] if i > 2 else run), True
        while more:
            low = value & 31
            value >>= 5
            more = value != (-1 if low & 16 else 0)
            text.append(chr(low + 48 + (32 if more else 0)))
    return "".join(text)


def rle_from_string(text: str) -> list[int]:
    """Return the run lengths of a text of ``rle_to_string``. Raises FormatError for a malformed text."""
    runs: list[int] = []
    value = shift = 0
    for character in text:
        bits = ord(character) - 48
        if not 0 <= bits < 64 or shift > 35:
            raise FormatError(f"a mask's run lengths hold {character!r}; export it again")
        value |= (bits & 31) << shift
        shift += 5
        if not bits & 32:
            if bits & 16:
                value -= 1 << shift
            runs.append(value + runs[-2] if len(runs) > 2 else value)
            value = shift = 0
    if shift:
        raise FormatError("a mask's run lengths are truncated; export it again")
    return runs
