"""Loop of recorded or rendered frames, the scene of a virtual camera."""

from collections.abc import Iterable
from itertools import islice
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.drivers.optris import HEIGHT, WIDTH
from sensors.errors import DeviceError
from sensors.rig.frame import RigFrame

T = TypeVar("T")
FRAMES_PER_SECOND = 30.0
AMBIENT_C = 22.0
LONGEST = 30  # frames kept of a source, 60 MB at most
ROUNDING_S = 1e-6  # s; rounding between stamps and the schedule


class FrameLoop:
    """Loop over the first frames of a source. Raises DeviceError for an empty source.

    A frame lasts from its stamp to the next, or 1/30 s if stamps do not rise. A frame without colour or
    temperatures repeats the frame before.
    """

    def __init__(self, frames: Iterable[RigFrame]) -> None:
        shown = tuple(islice(frames, LONGEST))
        if not shown:
            raise DeviceError("the virtual devices have no frames to show; give a session, or leave it out")
        self._starts_s, self._period_s = _times_s([frame.stamp_ns for frame in shown])
        self._depth = [frame.depth_mm for frame in shown]
        self._infrared = _filled([frame.infrared for frame in shown])
        self._color = _filled([frame.color_encoded for frame in shown])
        self._thermal = [_thermal(celsius) for celsius in _filled([frame.thermal_c for frame in shown])]

    def depth(self, seconds: float) -> NDArray[np.uint16]:
        """Return the depth image (h, w) in millimetres, ``seconds`` after the start."""
        return self._at(self._depth, seconds, "depth")

    def infrared(self, seconds: float) -> NDArray[np.uint16] | None:
        """Return the amplitude (h, w) of the depth image, ``seconds`` after the start, or None."""
        return self._at(self._infrared, seconds, "infrared") if self._infrared else None

    def color(self, seconds: float) -> bytes:
        """Return the encoded colour image, ``seconds`` after the start. Raises DeviceError without any."""
        return self._at(self._color, seconds, "colour")

    def thermal(self, seconds: float) -> NDArray[np.float32]:
        """Return the thermal image (120, 160) in Celsius, without gaps, ``seconds`` after the start.

        Raises DeviceError if the source has none.
        """
        return self._at(self._thermal, seconds, "thermal")

    def _at(self, images: list[T], seconds: float, name: str) -> T:
        if not images:
            raise DeviceError(
                f"the virtual devices have no {name} images to show; give a session that has some"
            )
        in_loop_s = (seconds + ROUNDING_S) % self._period_s
        return images[int(np.searchsorted(self._starts_s, in_loop_s, "right")) - 1]


def _times_s(stamps_ns: list[int]) -> tuple[NDArray[np.float64], float]:
    """Return the start (n,) of each frame and the period of the loop, in seconds."""
    starts_s: NDArray[np.float64] = (np.array(stamps_ns, np.int64) - stamps_ns[0]) * np.float64(1e-9)
    steps_s = np.diff(starts_s)
    if not len(steps_s) or steps_s.min() <= 0:
        starts_s, steps_s = np.arange(len(stamps_ns)) / FRAMES_PER_SECOND, np.array([1 / FRAMES_PER_SECOND])
    return starts_s, float(starts_s[-1] + np.median(steps_s))


def _filled(images: list[T | None]) -> list[T]:
    """Return the images with each missing image replaced by the previous one, at the start by the first."""
    there = [image for image in images if image is not None]
    filled = there[:1]
    for image in images if there else []:
        filled.append(filled[-1] if image is None else image)
    return filled[1:]


def _thermal(celsius: NDArray[np.float32]) -> NDArray[np.float32]:
    if celsius.shape != (HEIGHT, WIDTH):
        celsius = cv2.resize(celsius, (WIDTH, HEIGHT)).astype(np.float32)
    return np.nan_to_num(celsius, nan=AMBIENT_C)


class Noise:
    """Gaussian noise (h, w), shifted by some rows from image to image. shape: of the image."""

    def __init__(self, sd: float, shape: tuple[int, int]) -> None:
        self._height = shape[0]
        noise = np.random.default_rng(0).normal(0, sd, (2 * shape[0], shape[1]))
        self._noise: NDArray[np.float32] = noise.astype(np.float32)

    def __call__(self, number: int) -> NDArray[np.float32]:
        """Return the noise of image ``number``."""
        return self._noise[number * 7 % self._height :][: self._height]
