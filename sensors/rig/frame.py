"""Frame of the rig: synchronised images of all its cameras; and the base class of all sources of frames."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE
from sensors.files.images import encoded_size
from sensors.rig.rig_calibration import RigCalibration

FARTHEST_MM = 65534  # of 16 bits; 65535 is saturated
FRAME_PERIOD_NS = 33_333_333  # where neither the source nor its user states a rate


@dataclass(frozen=True)
class RigFrame:
    """Depth with the colour and temperature that belong to it; each in its own camera's pixels.

    depth_mm: uint16 (h, w) millimetres along z, 0 = no reading, lens distortion still in.
    color_encoded: the camera's own JPEG (or PNG) bytes, or None.
    thermal_c: float32 (h, w) degrees Celsius, NaN = no reading, or None.
    infrared: uint16 (h, w) amplitude in the depth camera's own pixels, or None; calibration needs it.
    stamp_ns: the depth camera's time. Raises FormatError for wrong types or shapes.
    """

    index: int
    stamp_ns: int
    depth_mm: NDArray[np.uint16]
    color_encoded: bytes | None = field(default=None, repr=False)
    thermal_c: NDArray[np.float32] | None = None
    infrared: NDArray[np.uint16] | None = None

    def __post_init__(self) -> None:
        for name, image in self._images().items():
            dtype = np.float32 if name == "thermal" else np.uint16
            if image is not None and (image.ndim != 2 or image.dtype != dtype):
                raise FormatError(
                    f"{name} image is {image.dtype} {image.shape}; give {dtype.__name__} with shape "
                    "(height, width)"
                )

    def _images(self) -> dict[str, NDArray[Any] | None]:
        return {"depth": self.depth_mm, "thermal": self.thermal_c, "infrared": self.infrared}

    def sized_as(self, calibration: RigCalibration) -> Self:
        """Return this frame unchanged. Raises CalibrationError where an image differs from its camera's
        size.
        """
        for name, image in self._images().items():
            camera = calibration.thermal if name == "thermal" else calibration.depth
            if image is not None and camera is not None:
                camera.check_size(f"{name} image of frame {self.index}", image.shape)
        return self

    def decode_color(self) -> NDArray[np.uint8] | None:
        """Return the colour image (h, w, 3) RGB, or None.

        An EXIF orientation is ignored: calibration and pose are for the sensor's pixels. Raises FormatError
        for a broken image.
        """
        if self.color_encoded is None:
            return None
        import cv2

        try:
            size = encoded_size(self.color_encoded)
        except FormatError as error:
            raise self._broken_color(str(error)) from error
        if max(size) > MAX_IMAGE_SIDE:
            raise self._broken_color(f"it claims {size[0]}x{size[1]} pixels")
        flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(np.frombuffer(self.color_encoded, np.uint8), flags)
        if image is None:
            raise self._broken_color("it is cut off or corrupt")
        return np.asarray(image, np.uint8)

    def _broken_color(self, why: str) -> FormatError:
        return FormatError(
            f"colour image of frame {self.index} cannot be decoded ({why}); drop it or record again"
        )


def mm_from_metres(depth_m: NDArray[np.floating[Any]]) -> NDArray[np.uint16]:
    """Return depth in whole millimetres; 0 for no reading and beyond ``FARTHEST_MM``."""
    with np.errstate(invalid="ignore", over="ignore"):  # signalling NaNs
        return _whole_mm(np.asarray(depth_m, np.float64) * 1000)


def mm_from_units(depth: NDArray[Any], unit_mm: float) -> NDArray[np.uint16]:
    """Return integers or floats of ``unit_mm`` millimetres each in whole millimetres."""
    if unit_mm == 1.0 and depth.dtype == np.uint16:
        return np.asarray(depth, np.uint16)
    with np.errstate(invalid="ignore", over="ignore"):
        return _whole_mm(depth.astype(np.float64) * unit_mm)


def _whole_mm(millimetres: NDArray[np.float64]) -> NDArray[np.uint16]:
    whole = np.rint(millimetres)
    return np.where((whole > 0) & (whole <= FARTHEST_MM), whole, 0).astype(np.uint16)


class FrameSource(ABC):
    """Recorded frames with random access: a session, a folder, a cloud, the virtual rig.

    name: a file's stem. calibration: valid for every frame. times_ns: int64 (n,), the depth stamps in the
    order of the frames. notes: absences and assumptions, one sentence each. path: the recording's file or
    folder, or None. subject: name of the recorded person, "" = unknown. named: True where labels of the
    frames may hold that name. events: (stamp in nanoseconds, text).
    cast: of a simulated recording's people (``synth.data_files``); real people count as ``training``.
    A subclass sets these and implements ``_frame``.
    """

    name: str
    calibration: RigCalibration
    times_ns: NDArray[np.int64]
    notes: tuple[str, ...] = ()
    path: Path | None = None
    subject: str = ""
    named: bool = False
    events: tuple[tuple[int, str], ...] = ()
    cast: str = "training"

    @property
    def sha256(self) -> str:
        """Return the SHA-256 of the recording's file, in hexadecimal; "" where the source is not one file."""
        return ""

    def __len__(self) -> int:
        return len(self.times_ns)

    def __iter__(self) -> Iterator[RigFrame]:
        # Not a generator, because that ends with the first frame that raises.
        return map(self.frame, range(len(self)))

    def frame(self, index: int) -> RigFrame:
        """Read frame ``index`` of 0 .. len - 1 alone. Raises IndexError, FormatError or CalibrationError."""
        if not 0 <= index < len(self):
            raise IndexError(
                f"{self.name} has {len(self)} frames; frame {index} does not exist: give 0 to {len(self) - 1}"
            )
        return self._frame(index).sized_as(self.calibration)

    @abstractmethod
    def _frame(self, index: int) -> RigFrame:
        """Read frame ``index``, which exists."""


def regular_times_ns(count: int, period_ns: int = FRAME_PERIOD_NS) -> NDArray[np.int64]:
    """Return stamps int64 (count,) for images that carry none."""
    return np.arange(count, dtype=np.int64) * period_ns
