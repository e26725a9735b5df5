"""Points of a cloud file as records: every field as the file has it, in the file's order and coordinates."""

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError, fault_of
from sensors.files.bounded import MAX_IMAGE_SIDE
from sensors.rig.rig_calibration import Pose

MAX_POINTS = 50_000_000  # some 50 bytes each in memory; untuned
MAX_HEADER_BYTES = 100_000  # untuned
_RGB = (("red", "r", "diffuse_red"), ("green", "g", "diffuse_green"), ("blue", "b", "diffuse_blue"))


@dataclass(frozen=True)
class CloudRecords:
    """All points of a file.

    records: structured array (n,) with x, y, z and all other fields, padding left out. grid: (height, width)
    of points in rows, or None. viewpoint: the pose ``cloud_from_sensor`` of a PCD, in the file's unit, or
    None. faces: number of a mesh's faces, which are not read.
    """

    records: NDArray[Any]
    grid: tuple[int, int] | None = None
    viewpoint: Pose | None = None
    faces: int = 0

    @property
    def organised(self) -> bool:
        """Return True if each point belongs to a pixel of an image."""
        return self.grid is not None and min(self.grid) > 1

    @property
    def splats(self) -> bool:
        """Return True if the points are centres of Gaussian splats (Kerbl 2023), by the names of their
        fields.
        """
        return {"scale_0", "rot_0", "opacity"} <= set(self.records.dtype.names or ())

    def points(self) -> NDArray[np.float64]:
        """Return coordinates (n, 3) in the file's unit and frame."""
        with np.errstate(invalid="ignore"):  # signalling NaNs
            return np.stack([self.records[axis].astype(np.float64) for axis in "xyz"], axis=-1)

    def step(self) -> float:
        """Return the finest resolution of the coordinates, in the file's unit; 0 for whole numbers."""
        step = 0.0
        for axis in "xyz":
            values = self.records[axis]
            if values.dtype.kind == "f":
                finite = np.abs(values[np.isfinite(values)])
                # The median, because stray points may be anywhere.
                step = max(step, float(np.spacing(np.median(finite)))) if len(finite) else step
        return step

    def colors(self) -> NDArray[np.uint8] | None:
        """Return RGB uint8 (n, 3); None without colour fields, or where all colours are black.

        PCL packs blue, green, red, alpha into the four bytes of ``rgb`` or ``rgba``, float or integer (PCL,
        ``PointXYZRGB``). Float channels are 0 to 1. 16-bit channels hold 8-bit values where none is above
        255, although the LAS format advises the full 16 bits.
        """
        names = {name.lower(): name for name in reversed(self.records.dtype.names or ())}
        packed = next((name for name in ("rgb", "rgba") if name in names), None)
        if packed is not None:
            rgb = _unpacked(self.records[names[packed]])
        else:
            found = [next((n for n in channel if n in names), None) for channel in _RGB]
            if None in found:
                return None
            rgb = _eight_bits(np.stack([self.records[names[name]] for name in found if name], axis=-1))
        return rgb if rgb is not None and rgb.any() else None


def grid_of(width: int, height: int, points: int) -> tuple[int, int] | None:
    """Return (height, width) if an image of that size has that many points, else None."""
    stated = width * height == points and min(width, height) > 0 and max(width, height) <= MAX_IMAGE_SIDE
    return (height, width) if stated else None


@contextmanager
def opened_cloud(path: Path, kind: str) -> Iterator[BinaryIO]:
    """Open a cloud file for a context; errors that a malformed file causes there become FormatError."""
    try:
        with path.open("rb") as file:
            yield file
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); check path and permissions") from error
    except (ValueError, KeyError, IndexError, TypeError, OverflowError) as error:
        why = f"{error} is missing or unknown" if isinstance(error, KeyError) else fault_of(error)
        raise FormatError(f"{path} is malformed ({why[:100]}); give a valid {kind} file") from error


def header_lines(file: BinaryIO, end: re.Pattern[bytes]) -> list[list[str]]:
    """Read a header up to the line ``end``: the words of each line. Comments may be of any encoding."""
    head = file.read(MAX_HEADER_BYTES)
    found = end.search(head)
    if found is None:
        raise ValueError("its header does not end")
    file.seek(found.end())
    lines = [line.split() for line in head[: found.end()].decode("utf-8", "replace").split("\n")]
    return [words for words in lines if words]


def text_numbers(file: BinaryIO, rows: int, columns: int) -> NDArray[np.float64]:
    """Read the next numbers of a text, NaN and infinity among them, as (rows, columns)."""
    count, claim = rows * columns, f"it claims {rows} points"
    with warnings.catch_warnings():
        # For text without numbers; newer versions of numpy raise ValueError.
        warnings.simplefilter("error", DeprecationWarning)
        try:
            values = np.fromfile(file, np.float64, count, sep=" ")
        except (ValueError, DeprecationWarning) as error:
            raise ValueError(f"{claim}, and some of its text is not a number") from error
    if len(values) != count:
        raise ValueError(f"{claim}, which are {count} numbers, and holds {len(values)}")
    return values.reshape(rows, columns)


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
    return np.asarray(rgb if int(rgb.max()) <= 255 else rgb.astype(np.uint16) >> 8, np.uint8)
