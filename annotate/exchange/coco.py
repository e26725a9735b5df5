"""COCO: ``annotations.json`` with run-length masks, and the depth images in ``images/``.

Format: cocodataset.org, "Data format"; the compressed run lengths are those of pycocotools' ``maskApi.c``
(``rleToString``). They are read here and not by pycocotools, which writes past its memory where a file is cut
off. A part is a category by its id, undefined is 255, a person's whole mask is category 100.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from annotate.array_types import Bool
from annotate.crop import window_of
from annotate.exchange.companion import MAX_TEXT_BYTES, Companion
from annotate.exchange.masks import MASK_IDS, PERSON, Mask, images_from, mask_from_runs, masks_of, runs_of
from annotate.frame_labels import FrameLabels
from annotate.labelset.images import decode_depth, encode_png
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded
from sensors.rig.camera import Intrinsics

ANNOTATIONS, IMAGES = "annotations.json", "images"
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


def read_coco(source: Path, companion: Companion) -> Iterator[FrameLabels]:
    """The inverse of ``write_coco``; masks as run lengths, compressed or not. Raises FormatError."""
    try:
        content = json.loads(read_bounded(source / ANNOTATIONS, MAX_TEXT_BYTES))
        names = {int(c["id"]): str(c["name"]) for c in content["categories"]}
        images = {int(image["id"]): image for image in content["images"]}
        by_image: dict[int, list[dict[str, Any]]] = {number: [] for number in images}
        for annotation in content["annotations"]:
            by_image[int(annotation["image_id"])].append(annotation)
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
        raise FormatError(f"{source / ANNOTATIONS} is not a COCO file ({str(error)[:80]!r})") from error
    yield from (_frame(source, images[n], by_image[n], names, companion) for n in images)


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


def _frame(
    source: Path,
    image: dict[str, Any],
    annotations: list[dict[str, Any]],
    names: dict[int, str],
    companion: Companion,
) -> FrameLabels:
    name = Path(str(image.get("file_name", ""))).name
    try:
        depth_mm = decode_depth(read_bounded(source / IMAGES / name))
        masks = (_mask(annotation, names, depth_mm.shape) for annotation in annotations)
        parts, persons = images_from(masks, depth_mm.shape)
    except (ValueError, KeyError, TypeError, IndexError, OverflowError) as error:
        raise FormatError(f"{source / ANNOTATIONS}, image {name[:100]!r}: {str(error)[:80]!r}") from error
    return companion.labels(name.removesuffix(".png"), depth_mm, parts, persons)


def _mask(annotation: dict[str, Any], names: dict[int, str], shape: tuple[int, int]) -> Mask:
    segmentation = annotation["segmentation"]
    if not isinstance(segmentation, dict):
        raise FormatError("a mask is a polygon; export run lengths (RLE), polygons are not exact")
    height, width = (int(side) for side in segmentation["size"])
    if (height, width) != shape:
        raise FormatError(f"a mask is {height}x{width} on an image of {shape}; export it again")
    counts = segmentation["counts"]
    runs = rle_from_string(counts) if isinstance(counts, str) else [int(n) for n in counts]
    pixels: Bool = mask_from_runs(runs, height * width).reshape((height, width), order="F")
    return Mask(names[int(annotation["category_id"])], int(annotation.get("person", 1)), pixels)


def rle_to_string(runs: list[int]) -> str:
    """Text of run lengths in COCO's compressed form.

    From the fourth on each is the difference to the last but one; each character, counted from "0", holds
    five bits and a sixth that is set while more of the number follows.
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
    """Inverse of ``rle_to_string``. Raises FormatError."""
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
