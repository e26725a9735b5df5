"""COCO: ``annotations.json`` with run-length masks, and the depth images in ``images/``.

Format: cocodataset.org, "Data format"; run lengths: ``coco_runs``. A part is a category by its id, undefined
is 255, a person's whole mask is category 100.
"""

import json
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
from natsort import natsorted

from annotate.crop import window_of
from annotate.exchange.coco_runs import pixels_of, rle_to_string
from annotate.exchange.companion import MAX_TEXT_BYTES, Companion
from annotate.exchange.image_names import DepthImages, frame_ids
from annotate.exchange.masks import MASK_IDS, PERSON, Mask, images_from, masks_of, runs_of
from annotate.exchange.polygons import FEW_CORNERS, POLYGONS, check_size, polygon_pixels
from annotate.frame_labels import FrameLabels
from annotate.labelset.images import encode_png
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded
from sensors.rig.camera import Intrinsics

ANNOTATIONS, IMAGES = "annotations.json", "images"
ROBOFLOW = "_annotations.coco.json"
LAYOUTS = (
    "annotations/instances_*.json",
    "instances_*.json",
    "annotations/*.json",
    ROBOFLOW,
    f"*/{ROBOFLOW}",
    "*.json",
)
"""Annotation files as CVAT and Roboflow name them, by glob pattern; the last are Label Studio's
``result.json``, FiftyOne's ``labels.json``, labelme2coco's ``dataset.json`` and any other name."""
KEYS = (b'"images"', b'"annotations"', b'"categories"')
"""Contents that make a file of any name COCO's."""
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
    """Return the annotation files of a folder under the first of the known names.

    CVAT's ``annotations/instances_SUBSET.json`` come first: its key points lie beside them.
    """
    for pattern in (ANNOTATIONS, *LAYOUTS):
        files = natsorted(file for file in source.glob(pattern) if file.is_file())
        if pattern == LAYOUTS[-1]:
            files = [file for file in files if _is_coco(file)]
        if files:
            return files
    return []


def _is_coco(file: Path) -> bool:
    data = read_bounded(file, MAX_TEXT_BYTES)
    return all(key in data for key in KEYS)


def read_coco(source: Path, companion: Companion) -> Iterator[FrameLabels]:
    """Read masks as run lengths, compressed or not, and polygons; the inverse of ``write_coco``.

    Raises FormatError.
    """
    files = [companion.annotations] if companion.annotations else annotation_files(source)
    images = [image for file in files for image in _images(source, file, companion)]
    ids, depth = frame_ids([image.name for image in images]), DepthImages(source)
    yield from (_frame(depth, *both, companion) for both in zip(images, ids, strict=True))


class _Image(NamedTuple):
    """An image of an annotation file. size: (height, width) as stated. categories: names by id."""

    file: Path
    name: str
    size: tuple[object, object]
    annotations: list[dict[str, Any]]
    categories: dict[str, str]


def _images(source: Path, file: Path, companion: Companion) -> list[_Image]:
    """Return the images of an annotation file, in its order; ids may be numbers or texts."""
    # Roboflow's splits are folders, each with its annotations and images.
    split = file.parent.name if file.name == ROBOFLOW and file.parent != source else ""
    try:
        content = json.loads(read_bounded(file, MAX_TEXT_BYTES))
        categories = {_key(c["id"]): str(c["name"]) for c in content["categories"]}
        images = {
            _key(image["id"]): _Image(
                file,
                str(PurePosixPath(split) / str(image["file_name"])) if split else str(image["file_name"]),
                (image.get("height"), image.get("width")),
                [],
                categories,
            )
            for image in content["images"]
        }
        for annotation in content["annotations"]:
            image = images.get(_key(annotation["image_id"]))
            if image is None:
                companion.remark("annotations of images that the file does not list are not read")
            else:
                image.annotations.append(annotation)
    except KeyError as error:
        raise FormatError(f"{file} is not a COCO file (it lacks {str(error)[:80]})") from error
    except (ValueError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise FormatError(f"{file} is not a COCO file ({str(error)[:80]!r})") from error
    return list(images.values())


def _key(number: object) -> str:
    """Return an id as text; 1.0, as pandas writes whole numbers, is 1."""
    return str(int(number) if isinstance(number, float) and number.is_integer() else number)


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


def _frame(depth: DepthImages, image: _Image, frame_id: str, companion: Companion) -> FrameLabels:
    try:
        depth_mm = depth.read(image.name)
        masks = (_mask(one, image, depth_mm.shape, companion) for one in image.annotations)
        parts, persons = images_from((mask for mask in masks if mask is not None), depth_mm.shape)
    except KeyError as error:
        raise FormatError(
            f"{image.file}, image {image.name[:100]!r}: an annotation lacks {str(error)[:80]}, or names a "
            "category that the file does not list; export instances as COCO"
        ) from error
    except (ValueError, TypeError, IndexError, OverflowError) as error:
        raise FormatError(f"{image.file}, image {image.name[:100]!r}: {str(error)[:80]!r}") from error
    return companion.labels(frame_id, depth_mm, parts, persons)


def _mask(
    annotation: dict[str, Any], image: _Image, shape: tuple[int, int], companion: Companion
) -> Mask | None:
    """Return the mask of an annotation; None for a box or key points alone, which are counted."""
    segmentation, name = annotation.get("segmentation"), image.categories[_key(annotation["category_id"])]
    person = int(annotation.get("person", 1))
    if isinstance(segmentation, dict):
        pixels, remark = pixels_of(segmentation, annotation.get("bbox"), shape)
        if remark:
            companion.remark(remark)
        return Mask(name, person, pixels)
    polygons = [np.array(one, np.float64).ravel() for one in _rings(segmentation)]
    drawn = [polygon for polygon in polygons if polygon.size >= 6]
    for _ in range(len(polygons) - len(drawn)):
        companion.remark(FEW_CORNERS)
    if not drawn:
        companion.remark("annotations without a mask (boxes, key points) are not read")
        return None
    check_size(image.size, shape)
    companion.remark(POLYGONS)
    pixels = np.zeros(shape, np.bool_)
    for polygon in drawn:
        if polygon.size % 2:
            raise FormatError(f"a polygon has {polygon.size} coordinates, an odd number; export it again")
        pixels |= polygon_pixels(polygon.reshape(-1, 2), shape)
    return Mask(name, person, pixels)


def _rings(segmentation: list[Any] | None) -> list[Any]:
    """Return the polygons of an annotation; some programs write one without the list around it."""
    rings = list(segmentation or [])
    return [rings] if rings and isinstance(rings[0], int | float) else rings
