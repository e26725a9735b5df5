"""The unit of a cloud's coordinates, which its file does not name, by the size of the scene."""

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError

METRES = 30.0
"""Distances (or sizes of clouds without a camera) up to this are metres: depth cameras see 0.2 to 10 m."""
MILLIMETRES = 600.0
"""Distances from this on are millimetres: as centimetres they are 6 m, farther than people are recorded."""
FARTHEST = 60_000.0
"""Distance above which no unit makes a person's scene: 60 m in millimetres."""
NEAREST = 0.1
"""Distance below which metres make no scene."""
STEPS_MM = {"millimetres": 1.0, "centimetres": 10.0, "inches": 25.4}
"""Units between metres and millimetres, in millimetres."""


def unit_mm(path: object, distance: float, along_m: NDArray[np.float64]) -> float:
    """Return the millimetres of a unit of the cloud.

    distance: typical distance from the camera, or the size of a cloud without one, in the file's unit.
    along_m: depths (n,) in the file's unit; cameras measure whole millimetres, so that these tell apart what
    the distance leaves open. Raises FormatError where the unit stays unknown, with the remedy.
    """
    if NEAREST <= distance <= METRES:
        return 1000.0
    if MILLIMETRES <= distance <= FARTHEST:
        return 1.0
    if METRES < distance < MILLIMETRES:
        for unit in STEPS_MM.values():
            if _whole(along_m * unit):
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
