"""Unit of a cloud's coordinates, by the size of the scene, because files state no unit."""

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError

METRES = 30.0
"""Largest distance, or size of a cloud without a camera, in metres: depth cameras measure 0.2 to 10 m."""
MILLIMETRES = 600.0
"""Least distance in millimetres: 600 cm are farther than people are recorded. Untuned."""
FARTHEST = 60_000.0
"""Largest distance in any unit: 60 m in millimetres. Untuned."""
NEAREST = 0.1
"""Least distance in any unit: 0.1 m, nearer than depth cameras measure."""
STEPS_MM = {"millimetres": 1.0, "centimetres": 10.0, "inches": 25.4}
"""Units between metres and millimetres, in millimetres."""


def unit_mm(path: object, distance: float, along: NDArray[np.float64]) -> float:
    """Return the millimetres of a unit of the cloud.

    distance: typical distance from the camera, or the size of a cloud without one, in the file's unit.
    along: depths (n,) in the file's unit. Cameras measure whole millimetres, so depths distinguish units
    where the distance does not. Raises FormatError where the unit stays unknown, with the remedy.
    """
    if NEAREST <= distance <= METRES:
        return 1000.0
    if MILLIMETRES <= distance <= FARTHEST:
        return 1.0
    if METRES < distance < MILLIMETRES:
        for unit in STEPS_MM.values():
            if _whole(along * unit):
                return unit
        guesses = ", ".join(f"{distance * unit / 1000:.2g} m as {name}" for name, unit in STEPS_MM.items())
        raise FormatError(
            f"{path}: half of the points are more than {distance:.4g} units away, whose length is unknown "
            f"({guesses}); "
            "import it with --depth-unit: 10 for centimetres, 25.4 for inches, 1 for millimetres"
        )
    raise FormatError(
        f"{path}: half of the points are {'more' if distance > 1 else 'less'} than {distance:.4g} units "
        "away, which is no scene with people in metres or millimetres; "
        "import it with --depth-unit, in millimetres"
    )


def _whole(depth_mm: NDArray[np.float64]) -> bool:
    """Return whether depths are whole millimetres, some of them no multiple of 5."""
    away = np.abs(depth_mm - np.rint(depth_mm))
    odd = np.mod(np.rint(depth_mm), 5) != 0
    return bool(len(depth_mm) > 20 and np.percentile(away, 95) < 0.05 and odd.mean() > 0.2)
