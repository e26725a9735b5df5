"""COCO: ``annotations.json`` with run-length masks, and the depth images in ``images/``.

Format: cocodataset.org, "Data format"; run lengths: ``coco_runs``. A part is a category by its id, undefined
is 255, a person's whole mask is category 100.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from natsort import natsorted

from annotate.crop import window_of
from annotate.exchange.coco_runs import pixels_of, rle_to_string
from annotate.exchange.companion import MAX_TEXT_BYTES, Companion
from annotate.exchange.image_names import frame_ids, read_depth
from annotate.exchange.masks import MASK_IDS, PERSON, Mask, images_from, masks_of, runs_of
from annotate.exchange.polygons import POLYGONS, polygon_pixels
from annotate.frame_labels import FrameLabels
from annotate.labelset.images import encode_png
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded
from sensors.rig.camera import Intrinsics

ANNOTATIONS, IMAGES = "annotations.json", "images"
LAYOUTS = (
    "annotations/instances_*.json",
    "instances_*.json",
    "annotations/*.json",
    "_annotations.coco.json",
    "result.json",
)
"""Annotation files as CVAT, Roboflow and Label Studio name them, by glob pattern."""
CATEGORIES = {**MASK_IDS, PERSON: 100}
"""Category by the name of a mask."""


def write_coco(frames: Iterator[FrameLabels], camera: Intrinsics, out: Path) -> None:
    """Write into an empty folder."""
    (out / IMAGES).mkdir()
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for frame in frames:
        height, width = frame.parts.shape
        name = f"{frame.frame_id}.png"
        (out / IMAGES / name).write_bytes(encode_png(frame.depth_mm))
        images.append({"id": len(images) + 1, "file_name": name, "width": width, "height": height})
        for mask in masks_of(frame):
            annotations.append(_annotation(mask, len(annotations) + 1, len(images)))
    categories = [{"id": n, "name": name, "supercategory": "person"} for name, n in CATEGORIES.items()]
    content = {"images": images, "annotations": annotations, "categories": categories}
    (out / ANNOTATIONS).write_text(json.dumps(content), encoding="ascii")


def annotation_files(source: Path) -> list[Path]:
    """Return the annotation files of a folder, as this project, CVAT, Roboflow and Label Studio name them.

    CVAT's ``annotations/instances_SUBSET.json`` come first: its key points lie beside them.
    """
    for pattern in (ANNOTATIONS, *LAYOUTS):
        if files := natsorted(source.glob(pattern)):
            return files
    return []


def read_coco(source: Path, companion: Companion) -> Iterator[FrameLabels]:
    """Read masks as run lengths, compressed or not, and polygons; the inverse of ``write_coco``.

    Raises FormatError.
    """
    images = [image for file in annotation_files(source) for image in _images(file)]
    ids = frame_ids([image.name for image in images])
    yield from (_frame(source, *both, companion) for both in zip(images, ids, strict=True))


class _Image(NamedTuple):
    """An image of an annotation file: its name, its annotations, and the names of categories by id."""

    file: Path
    name: str
    annotations: list[dict[str, Any]]
    categories: dict[str, str]


def _images(file: Path) -> list[_Image]:
    """Return the images of an annotation file, in its order; ids may be numbers or texts."""
    try:
        content = json.loads(read_bounded(file, MAX_TEXT_BYTES))
        categories = {str(c["id"]): str(c["name"]) for c in content["categories"]}
        images = {
            str(image["id"]): _Image(file, str(image["file_name"]), [], categories)
            for image in content["images"]
        }
        for annotation in content["annotations"]:
            images[str(annotation["image_id"])].annotations.append(annotation)
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
        raise FormatError(f"{file} is not a COCO file ({str(error)[:80]!r})") from error
    return list(images.values())


def _annotation(mask: Mask, number: int, image: int) -> dict[str, Any]:
    height, width = mask.pixels.shape
    rows, columns = window_of(mask.pixels)
    counts = rle_to_string(runs_of(mask.pixels.ravel(order="F")))
    extra = {"person": mask.person} if mask.name == PERSON else {}
    return {
        "id": number,
        "image_id": image,
        "category_id": CATEGORIES[mask.name],
        "segmentation": {"size": [height, width], "counts": counts},
        "area": int(mask.pixels.sum()),
        "bbox": [columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start],
        "iscrowd": 0,
        **extra,
    }


def _frame(source: Path, image: _Image, frame_id: str, companion: Companion) -> FrameLabels:
    try:
        depth_mm = read_depth(source, image.name)
        shape = depth_mm.shape
        masks = (_mask(one, image.categories, shape, companion) for one in image.annotations)
        parts, persons = images_from((mask for mask in masks if mask is not None), shape)
    except (ValueError, KeyError, TypeError, IndexError, OverflowError) as error:
        raise FormatError(f"{image.file}, image {image.name[:100]!r}: {str(error)[:80]!r}") from error
    return companion.labels(frame_id, depth_mm, parts, persons)


def _mask(
    annotation: dict[str, Any], categories: dict[str, str], shape: tuple[int, int], companion: Companion
) -> Mask | None:
    """Return the mask of an annotation; None for a box or key points alone, which are counted."""
    segmentation, name = annotation.get("segmentation"), categories[str(annotation["category_id"])]
    person = int(annotation.get("person", 1))
    if not segmentation:
        companion.remark("annotations without a mask (boxes, key points) are not read")
        return None
    if isinstance(segmentation, dict):
        pixels, remark = pixels_of(segmentation, annotation.get("bbox"), shape)
        if remark:
            companion.remark(remark)
        return Mask(name, person, pixels)
    companion.remark(POLYGONS)
    pixels = np.zeros(shape, np.bool_)
    for polygon in segmentation:
        pixels |= polygon_pixels(np.array(polygon, np.float64).reshape(-1, 2), shape)
    return Mask(name, person, pixels)
