"""Points of a cloud file as records: every field as the file has it, in the file's order and coordinates."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.files.bounded import MAX_IMAGE_SIDE
from sensors.rig.rig_calibration import Pose

MAX_POINTS = 50_000_000
"""Points of a cloud, some 50 bytes each in memory; untuned."""

_RED = ("red", "r", "diffuse_red")
_GREEN = ("green", "g", "diffuse_green")
_BLUE = ("blue", "b", "diffuse_blue")


@dataclass(frozen=True)
class CloudRecords:
    """All points of a file.

    records: structured array (n,) with x, y, z and whatever else the file has, padding left out.
    grid: (height, width) of points in rows, or None.
    viewpoint: the sensor's pose ``cloud_from_sensor`` that a PCD states, in the file's unit, or None.
    faces: number of a mesh's faces, which are not read.
    """

    records: NDArray[Any]
    grid: tuple[int, int] | None = None
    viewpoint: Pose | None = None
    faces: int = 0

    @property
    def organised(self) -> bool:
        """Whether each point belongs to a pixel of an image (an organised cloud)."""
        return self.grid is not None and min(self.grid) > 1

    def points(self) -> NDArray[np.float64]:
        """Return coordinates (n, 3) in the file's unit and frame."""
        with np.errstate(invalid="ignore"):  # signalling NaNs
            return np.stack([self.records[axis].astype(np.float64) for axis in "xyz"], axis=-1)

    @property
    def splats(self) -> bool:
        """Whether the points are the centres of Gaussians (Kerbl 2023), by the names of their fields."""
        return {"scale_0", "rot_0", "opacity"} <= set(self.records.dtype.names or ())

    def step(self) -> float:
        """Return the largest step between coordinates, in the file's unit; 0 for whole numbers."""
        step = 0.0
        for axis in "xyz":
            values = self.records[axis]
            if values.dtype.kind == "f":
                there = np.abs(values[np.isfinite(values)])
                # The median: stray points may be anywhere.
                step = max(step, float(np.spacing(np.median(there)))) if len(there) else step
        return step

    def colors(self) -> NDArray[np.uint8] | None:
        """Return RGB (n, 3), or None where no field holds colours, or all of them are black.

        PCL packs blue, green, red, alpha into the four bytes of ``rgb`` or ``rgba``, float or whole number
        (PCL, ``PointXYZRGB``). Separate channels of floats are 0 to 1; those of 16 bits are 8 bits where no
        value is larger (the LAS format's own advice is 16).
        """
        names = {name.lower(): name for name in reversed(self.records.dtype.names or ())}
        packed = next((name for name in ("rgb", "rgba") if name in names), None)
        if packed is not None:
            rgb = _unpacked(self.records[names[packed]])
        else:
            found = [next((n for n in channel if n in names), None) for channel in (_RED, _GREEN, _BLUE)]
            if None in found:
                return None
            rgb = _eight_bits(np.stack([self.records[names[name]] for name in found if name], axis=-1))
        return rgb if rgb is not None and rgb.any() else None


def grid_of(width: int, height: int, points: int) -> tuple[int, int] | None:
    """Return (height, width) where they are an image's of that many points, else None."""
    stated = width * height == points and min(width, height) > 0 and max(width, height) <= MAX_IMAGE_SIDE
    return (height, width) if stated else None


def _unpacked(packed: NDArray[Any]) -> NDArray[np.uint8] | None:
    if packed.dtype.itemsize != 4 or packed.ndim != 1:
        return None
    words = np.ascontiguousarray(packed).view(packed.dtype.str[0].replace("|", "<") + "u4")
    return np.stack([words >> shift & 255 for shift in (16, 8, 0)], axis=-1).astype(np.uint8)


def _eight_bits(rgb: NDArray[Any]) -> NDArray[np.uint8] | None:
    if rgb.ndim != 2 or not len(rgb):
        return None
    if rgb.dtype.kind == "f":
        with np.errstate(invalid="ignore"):
            bright = np.nan_to_num(rgb, nan=0.0, posinf=0.0, neginf=0.0)
            scaled = bright * 255 if bright.max() <= 1 else bright
            return np.asarray(np.clip(np.rint(scaled), 0, 255), np.uint8)
    largest = int(rgb.max())
    return np.asarray(rgb if largest <= 255 else rgb.astype(np.uint16) >> 8, np.uint8)
