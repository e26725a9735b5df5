"""A simple picture for virtual cameras."""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.drivers.optris import HEIGHT, WIDTH
from sensors.rig.frame import RigFrame
from sensors.virtual.frame_loop import AMBIENT_C, FRAMES_PER_SECOND


@lru_cache(maxsize=1)
def swinging_ball(count: int = 10) -> tuple[RigFrame, ...]:
    """A warm ball of 33 C that swings before a wall of 22 C, as depth, colour and temperature."""
    return tuple(_frame(index, np.sin(2 * np.pi * index / count)) for index in range(count))


@lru_cache(maxsize=1)
def small_ball() -> tuple[RigFrame, ...]:
    """The same with every image an eighth as wide, for tests that look at many frames."""
    return tuple(_small(frame) for frame in swinging_ball())


def _small(frame: RigFrame) -> RigFrame:
    color = cv2.imdecode(np.frombuffer(frame.color_encoded or b"", np.uint8), cv2.IMREAD_REDUCED_COLOR_8)
    encoded = cv2.imencode(".jpg", color[:134])[1].tobytes()
    assert frame.infrared is not None
    depth, infrared = np.ascontiguousarray(frame.depth_mm[::8, ::8]), frame.infrared[::8, ::8]
    return RigFrame(frame.index, frame.stamp_ns, depth, encoded, frame.thermal_c, infrared)


def _frame(index: int, swing: float) -> RigFrame:
    depth = np.where(_ball(424, 512, swing), 1500, 2500).astype(np.uint16)
    color = np.where(_ball(1080, 1920, swing)[..., None], (60, 80, 200), (120, 130, 120)).astype(np.uint8)
    thermal = np.where(_ball(HEIGHT, WIDTH, swing), 33.0, AMBIENT_C).astype(np.float32)
    encoded = cv2.imencode(".jpg", color)[1].tobytes()
    infrared = np.where(_ball(424, 512, swing), 9000, 3000).astype(np.uint16)
    return RigFrame(index, round(index * 1e9 / FRAMES_PER_SECOND), depth, encoded, thermal, infrared)


def _ball(height: int, width: int, swing: float) -> NDArray[np.bool_]:
    v, u = np.ogrid[:height, :width]
    away = np.hypot(u - width * (0.5 + 0.2 * swing), v - height / 2)
    return np.asarray(away < height / 4, np.bool_)
