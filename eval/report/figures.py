"""Pictures for the report: depth, labels and errors as uint8 RGB images, cropped and embedded."""

import base64

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, UInt8, UInt16
from annotate.parts import BACKGROUND, LEFT_RIGHT, NEIGHBOURS, UNDEFINED, palette_rgb
from eval.scores.confusion import Labels, named

Image = UInt8

CANVAS = (24, 24, 28)
"""Colour of nothing, as in the palette of parts; chosen by eye."""

ERROR_KINDS = {
    "missed_person": ("Missed person", (79, 151, 255)),
    "invented_person": ("Invented person", (247, 201, 72)),
    "left_right_swap": ("Left-right swap", (236, 96, 204)),
    "neighbour_part": ("Neighbouring part", (240, 132, 74)),
    "other_part": ("Other part", (214, 48, 49)),
}
"""Title and colour of the kinds of `eval.scores.confusion.error_kinds`."""

_OTHERS = {"Background": CANVAS, "Correct": (92, 99, 112), "Undefined": (52, 52, 58)}

ERROR_NAMES = (*_OTHERS, *(title for title, _ in ERROR_KINDS.values()))
ERROR_RGB = (*_OTHERS.values(), *(rgb for _, rgb in ERROR_KINDS.values()))
"""Titles and colours of what an error picture shows; the background is first."""


def colorize_depth(depth_mm: UInt16) -> Image:
    """Depth (h, w) as grey (h, w, 3), near bright; its own 2nd to 98th percentile span the greys."""
    valid = depth_mm > 0
    image = np.full((*depth_mm.shape, 3), CANVAS, np.uint8)
    if valid.any():
        near, far = np.percentile(depth_mm[valid], [2, 98])
        nearness = 1 - (depth_mm[valid] - near) / max(far - near, 1.0)
        image[valid] = (70 + 185 * np.clip(nearness, 0, 1)).astype(np.uint8)[:, None]
    return image


def colorize_parts(parts: Labels) -> Image:
    """Labels (h, w) in the colours of `annotate.parts` (h, w, 3)."""
    return palette_rgb()[parts]


def colorize_share(values: Float32) -> Image:
    """Values (h, w) in [0, 1] from dark violet to yellow (h, w, 3); NaN is nothing."""
    known = np.isfinite(values)
    levels = np.where(known, np.clip(values, 0, 1) * 255, 0).astype(np.uint8)
    image = np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)[..., ::-1], np.uint8).copy()
    image[~known] = CANVAS
    return image


def colorize_error(truth: Labels, predicted: Labels) -> Image:
    """What went wrong where, (h, w, 3): grey where the part is right, else in `ERROR_KINDS` colours."""
    return np.array(ERROR_RGB, np.uint8)[error_kind_ids(truth, predicted)]


def error_kind_ids(truth: Labels, predicted: Labels) -> Labels:
    """What went wrong where (h, w), as an index into `ERROR_NAMES` and `ERROR_RGB`."""
    guess = named(predicted)
    person, seen = truth != BACKGROUND, guess != BACKGROUND
    wrong = (truth != guess) & person & seen
    twin, neighbour = _pairs(LEFT_RIGHT), _pairs(tuple(tuple(pair) for pair in NEIGHBOURS))
    masks = {
        "Correct": person & (truth == guess),
        "other_part": wrong,
        "neighbour_part": wrong & neighbour[truth, guess],
        "left_right_swap": wrong & twin[truth, guess],
        "missed_person": person & ~seen,
        "invented_person": ~person & seen,
        "Undefined": truth == UNDEFINED,
    }
    kinds = np.zeros(truth.shape, np.uint8)
    for name, mask in masks.items():
        kinds[mask] = ERROR_NAMES.index(ERROR_KINDS[name][0] if name in ERROR_KINDS else name)
    return kinds


def _pairs(pairs: tuple[tuple[int, ...], ...]) -> Bool:
    table = np.zeros((256, 256), np.bool_)
    for a, b in pairs:
        table[a, b] = table[b, a] = True
    return table


def data_uri(image: Image) -> str:
    """An RGB image as a data URI: PNG where it has few colours, as labels have, else WebP."""
    flat = image.reshape(-1, 3).astype(np.int32)
    few = np.unique(flat @ np.array([65536, 256, 1])).size <= 64
    bgr = np.ascontiguousarray(image[..., ::-1])
    if few:
        kind, (_, data) = "png", cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    else:
        kind, (_, data) = "webp", cv2.imencode(".webp", bgr, [cv2.IMWRITE_WEBP_QUALITY, 85])
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode()}"
