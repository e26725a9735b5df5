"""Units of depth, and selection of the units that make a possible scene with people.

Sources of the units: 1 mm is common; TUM RGB-D "File Formats" (1/5000 m); librealsense (D405: 0.1 mm, L515:
0.25 mm); libfreenect and NYU's raw Kinect v1 words (13 bits of millimetres above 3 bits of player index); SUN
RGB-D (words rotated by the same 3 bits); libfreenect2 (floats in millimetres). Constants are untuned unless a
source is given.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError, Note, Setting

NEAREST_M = 4.5  # where nothing is nearer, an assumed unit is wrong; a Kinect v2 measures to 4.5 m
NEAR_M, MEDIAN_M = 2.5, 7.5  # the same where nothing is nearer than the one and half farther than the other
CONVENTION = 2.0  # times by which these are farther for floats, which are metres by convention (REP 118)
CLOSE_M, CLOSE_MEDIAN_M = 0.15, 0.4  # where something is nearer, or half is, no other unit is taken
FARTHEST_M = 0.3  # where nothing is farther, an assumed unit is wrong
LEAST_PIXELS = 200  # readings below which nothing is judged
UNITS_MM = {
    0.1: "D405",
    0.125: "Kinect v1 words above a player index, SUN RGB-D",
    0.2: "TUM, 1/5000 m",
    0.25: "L515",
    1.0: "millimetres",
    10.0: "centimetres",
    1000.0: "metres",
}  # millimetres of a step, and the programs that write it


def metres(length_m: float) -> str:
    """Return a length as text with three digits."""
    return f"{length_m:.0f} m" if length_m >= 100 else f"{length_m:.3g} m"


class Range(NamedTuple):
    """Depth of a scene in metres: the 1st, 50th and 99th percentile of its readings."""

    near: float
    median: float
    far: float

    def __str__(self) -> str:
        return ", ".join(map(metres, self))


def range_of(values: NDArray[np.float64], unit_mm: float) -> Range:
    return Range(*(np.percentile(values, (1, 50, 99)) * unit_mm / 1000).tolist())


def impossible(found: Range, times: float = 1.0) -> str:
    """Return the reason why a range is impossible for a scene with people, or "".

    times: factor on the bounds of the least and the median depth.
    """
    if found.near > NEAREST_M * times:
        return f"nothing is nearer than {metres(found.near)}"
    if found.near > NEAR_M * times and found.median > MEDIAN_M * times:
        return f"nothing is nearer than {metres(found.near)} and half is farther than {metres(found.median)}"
    return f"nothing is farther than {metres(found.far)}" if found.far < FARTHEST_M else ""


def _is_usual(found: Range) -> bool:
    """Return whether a range is usual for cameras of people in rooms."""
    return not impossible(found) and found.near > CLOSE_M and CLOSE_MEDIAN_M < found.median < MEDIAN_M


def unit_of(
    values: NDArray[np.float64], floats: bool, declared: float | None, where: str, likely: float | None
) -> tuple[float, list[str]]:
    """Return the millimetres of a step, and notes. Raises FormatError where an assumed unit is impossible."""
    usual = 1000.0 if floats else 1.0
    if declared is not None or len(values) < LEAST_PIXELS:
        return declared or usual, []
    found = range_of(values, usual)
    why = impossible(found, CONVENTION if floats else 1.0)
    if not why:
        return usual, []
    for other in ([1.0] if floats else []) + ([likely] if likely else []):
        if _is_usual(range_of(values, other)):
            taken = f"{other:g} mm a step taken, because {why} with {usual:g}; else give the unit"
            return other, [Note(taken, Setting.DEPTH_UNIT)]
    raise FormatError(
        f"{where}: {why} with {usual:g} mm a step, which no file declares (1st, 50th and 99th percentile: "
        f"{found}); {remedy(values, usual)}",
        Setting.DEPTH_UNIT,
    )


def remedy(values: NDArray[np.float64], usual: float) -> str:
    """Return the units that give a possible scene, as text; a unit that divides all values comes first."""
    whole = values[values == np.rint(values)].astype(np.int64)
    common = int(np.gcd.reduce(whole[:: max(1, len(whole) // 1000)])) if len(whole) == len(values) else 1
    fits = [
        (f"{unit:g} ({who}) gives {found}", unit * common == 1)
        for unit, who in UNITS_MM.items()
        if unit != usual and _is_usual(found := range_of(values, unit))
    ]
    fits.sort(key=lambda fit: not fit[1])
    if not fits:
        return "these may be disparity, temperatures or infrared; else give the millimetres of a step"
    units = "; ".join(text for text, _ in fits[:4])
    return (
        "disparity, temperatures and infrared are not depth; for depth give the millimetres of a step, or "
        f"depth_unit_mm in intrinsics.json: {units}"
    )
