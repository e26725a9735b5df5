"""Check of temperatures, which finds the scale of a thermal image's 16-bit words.

The median of a scene of people lies between a winter's day and a hot room. For such temperatures the words of
different scales do not overlap. Constants are untuned unless a source is given.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.checks.depth_units import LEAST_PIXELS
from sensors.errors import FormatError

COLDEST_C, HOTTEST_C = -30.0, 70.0  # median of a scene with people, outdoors or beside machines
ROOM_C = (0.0, 45.0)  # a median outside is a doubt
INDOORS_C = (10.0, 45.0)  # median by which a scale precedes all others
SPREAD_C = (-40.0, 90.0)  # nine tenths of a scene with people: sky is colder, ovens are hotter
NO_READING = 65535  # saturated word


@dataclass(frozen=True)
class Scale:
    """Scale of thermal words: celsius = word * step + offset; in integers 0 and 65535 mean no reading."""

    name: str
    step: float
    offset: float

    def celsius(self, words: NDArray[Any]) -> NDArray[np.float32]:
        """Return float32 (h, w) degrees Celsius, NaN = no reading."""
        values = words.astype(np.float64)
        good = np.isfinite(values)
        if words.dtype.kind in "iu":
            good &= (values > 0) & (values != NO_READING)
        return np.where(good, values * self.step + self.offset, np.nan).astype(np.float32)


SESSION = Scale("(degrees Celsius + 100) x 100", 0.01, -100.0)
KELVINS = (
    Scale("hundredths of a kelvin", 0.01, -273.15),
    Scale("tenths of a kelvin", 0.1, -273.15),
    Scale("kelvin", 1.0, -273.15),
)
OF_CAMERAS = (
    *KELVINS,
    Scale("fiftieths of a kelvin, a Boson's in low gain", 0.02, -273.15),
    Scale("64ths of a kelvin, an InfiRay's", 1 / 64, -273.15),
)
"""Scales of cameras' words. They overlap only for the last two, from 15,561 to 17,157. Sources: Lepton
datasheet 500-0659 rev 203, telemetry word C49 (0.1 or 0.01 K); notes on FLIR's Boson SDK (TLinear: kelvin x
100 in high gain, x 50 in low gain); viewers for InfiRay's P2 Pro and Topdon's TC001 (word / 64)."""
INTEGERS = (SESSION, *KELVINS, OF_CAMERAS[-1], Scale("hundredths of a degree Celsius", 0.01, 0.0))
FLOATS = (Scale("degrees Celsius", 1.0, 0.0), Scale("kelvin", 1.0, -273.15))


def judge_celsius(samples: Sequence[NDArray[Any]], where: str) -> tuple[Scale, tuple[str, ...]]:
    """Return the scale of thermal images (h, w), integers or floats, and notes on assumptions.

    The default scale is a session's for integers, and degrees Celsius for floats. Raises FormatError where
    the median of the samples is impossible in every scale.
    """
    whole = not samples or samples[0].dtype.kind in "iu"
    scales, usual = (INTEGERS, (SESSION, *KELVINS)) if whole else (FLOATS, FLOATS)
    if not np.isfinite(_median(samples, scales[0])):
        return scales[0], ()
    remedy = f"write {scales[0].name}"
    room = (scale for scale in scales if _is_room(samples, scale))
    cold = (scale for scale in usual if COLDEST_C <= _median(samples, scale) <= HOTTEST_C)
    scale = next(room, None) or next(cold, None)
    if scale is None:
        raise FormatError(
            f"{where}: temperatures have a median of {_median(samples, scales[0]):.0f} C; {remedy}, "
            "not raw counts"
        )
    median, notes = _median(samples, scale), []
    if scale is not scales[0]:
        notes.append(
            f"temperatures are {scale.name}: their median is {median:.1f} C; {remedy} if that is wrong"
        )
    if not ROOM_C[0] <= median <= ROOM_C[1]:
        notes.append(f"doubtful temperatures: their median is {median:.1f} C; {remedy} if that is wrong")
    return scale, tuple(notes)


def scales_of_cameras(words: NDArray[np.uint16]) -> list[Scale]:
    """Return the scales in which the median of words (h, w) is possible for a scene of people."""
    return [scale for scale in OF_CAMERAS if COLDEST_C <= _median([words], scale) <= HOTTEST_C]


def _is_room(samples: Sequence[NDArray[Any]], scale: Scale) -> bool:
    """Return whether the samples are possible room temperatures in a scale: their median, and nine tenths of
    them.
    """
    if not INDOORS_C[0] <= _median(samples, scale) <= INDOORS_C[1]:
        return False
    low, high = np.percentile(_values(samples, scale), (5, 95)).tolist()
    return bool(low > SPREAD_C[0] and high < SPREAD_C[1])


def _median(samples: Sequence[NDArray[Any]], scale: Scale) -> float:
    values = _values(samples, scale)
    return float(np.median(values)) if len(values) >= LEAST_PIXELS else float("nan")


def _values(samples: Sequence[NDArray[Any]], scale: Scale) -> NDArray[np.float32]:
    values = np.concatenate([scale.celsius(image).ravel() for image in samples])
    return np.asarray(values[np.isfinite(values)], np.float32)
