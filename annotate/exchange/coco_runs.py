"""Run lengths of COCO's masks, counted by columns or by rows.

COCO counts column by column. The compressed form is that of pycocotools' ``maskApi.c`` (``rleToString``). Run
lengths are read here and not by pycocotools, which writes past its memory where a file is cut off.
"""

from typing import Any

import numpy as np

from annotate.array_types import Bool
from annotate.crop import window_of
from annotate.exchange.masks import mask_from_runs
from sensors.errors import FormatError

BOX_TOLERANCE_PX = 1.5
"""Pixels between a side of a stated box and of the mask at most: programs round in several ways. Untuned."""


def pixels_of(segmentation: dict[str, Any], box: object, shape: tuple[int, int]) -> tuple[Bool, str]:
    """Return the pixels (h, w) of run lengths, and a remark or "".

    Some programs count runs row by row, which is as valid; the annotation's ``bbox`` shows the direction.
    Raises FormatError.
    """
    height, width = (int(side) for side in segmentation["size"])
    if (height, width) != shape:
        raise FormatError(f"a mask is {height}x{width} on an image of {shape}; export it again")
    counts = segmentation["counts"]
    runs = rle_from_string(counts) if isinstance(counts, str) else [int(n) for n in counts]
    flat = mask_from_runs(runs, height * width)
    by_columns = flat.reshape((height, width), order="F")
    if not flat.any() or _fits(by_columns, box):
        return by_columns, ""
    by_rows = flat.reshape((height, width))
    if _fits(by_rows, box):
        return (
            by_rows,
            "masks have run lengths row by row, not column by column; bbox shows it",
        )
    return by_columns, "masks do not fit their bbox; their run lengths are read column by column"


def _fits(pixels: Bool, box: object) -> bool:
    """Return whether a mask has the stated box [x, y, width, height]; True without a box."""
    if not isinstance(box, list) or len(box) != 4:
        return True
    rows, columns = window_of(pixels)
    own = (columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start)
    return bool(np.abs(np.array(box, np.float64) - own).max() <= BOX_TOLERANCE_PX)


def rle_to_string(runs: list[int]) -> str:
    """Write run lengths in COCO's compressed form.

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
    """Invert ``rle_to_string``. Raises FormatError."""
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
