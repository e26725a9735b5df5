"""Scores as JSON: by name, null where there is nothing to score."""

from collections.abc import Sequence
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from annotate.parts import BODY_PARTS
from eval.scores.boundary import DISTANCE_EDGES_PX, TOLERANCES_MM, TOLERANCES_PX, WIDTHS_MM, WIDTHS_PX
from eval.scores.confusion import Scores
from eval.scores.scores import PART_SCORES

JsonScore: TypeAlias = "float | list[JsonScore] | dict[str, JsonScore] | None"


def _lengths(values: Sequence[float], unit: str) -> list[str]:
    return [f"{value:g} {unit}" for value in values]


DISTANCES = (
    *(
        f"{low:g} px" if high - low == 1 else f"{low:g} to {high - 1:g} px"
        for low, high in pairwise((0.0, *DISTANCE_EDGES_PX))
    ),
    f"{DISTANCE_EDGES_PX[-1]:g} px and more",
)
"""Names of the distance bins; a pixel belongs to the whole number below its distance."""

_NAMES = {
    "boundary_f_px": _lengths(TOLERANCES_PX, "px"),
    "boundary_f_mm": _lengths(TOLERANCES_MM, "mm"),
    "boundary_iou_px": _lengths(WIDTHS_PX, "px"),
    "boundary_iou_mm": _lengths(WIDTHS_MM, "mm"),
    "error_by_distance": list(DISTANCES),
}
"""Names along a score's last axis; the parts' scores have those of the parts."""


def plain(values: Scores | float) -> JsonScore:
    """Numbers as JSON has them: NaN, which it lacks, becomes null."""
    array = np.asarray(values, np.float64)
    if array.ndim:
        return [plain(value) for value in array]
    return float(array) if np.isfinite(array) else None


def named(name: str, values: Scores) -> JsonScore:
    """A score, or its interval (2, ...), with names along its last axis; background is left out."""
    if name in PART_SCORES:
        return {part.name: plain(values[..., part.id]) for part in BODY_PARTS}
    if name == "error_by_distance_by_part":
        return {part.name: named("error_by_distance", values[..., part.id, :]) for part in BODY_PARTS}
    if name in _NAMES:
        return {key: plain(values[..., i]) for i, key in enumerate(_NAMES[name])}
    return plain(values)
