"""The person in a thermal cloud: warm, connected in space, of human size.

Nishi & Miura 2017, section 4.2.1, take every point of 25 to 35 degrees Celsius. Here that window only
sets the marks; hair, cold cloth and points without a temperature are decided by the surface they
belong to, and a sofa by being colder than halfway to the person beside it.
"""

from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.cloud import ThermalCloud
from annotate.grid import components, flood
from annotate.shapes import Piece, measure, without_planes

WINDOW_C = (25.0, 35.0)
"""Surface temperatures of a dressed person in a room (Nishi & Miura 2017, section 4.2.1)."""
HOT_MARGIN_C = 2.0
"""A radiometric camera is off by up to +-2 degrees (Optris PI200): so far above the window is unsure."""

MIN_PERSON_M2, MAX_PERSON_M2 = 0.03, 2.5
"""Visible surface of a person: from a head and a shoulder to twice the front of a tall adult."""
MAX_PERSON_M = 2.4
"""Longest extent of a person, arms raised."""
MIN_THICKNESS_M = 0.02
"""A person's smallest standard deviation in space; screens, radiators and windows are flatter."""

PERSON, OTHER, NO_PIXEL = 1, 2, 255


@dataclass(frozen=True)
class PersonMask:
    """Which pixels (h, w) of the undistorted depth image are the person; a subset of the valid ones.

    method: "thermal", or "depth" where the cloud has no temperatures. notes: what a user should know,
    e.g. why the mask is empty.
    """

    mask: NDArray[np.bool_]
    method: Literal["thermal", "depth"]
    notes: tuple[str, ...] = field(default=())


def extract_person(cloud: ThermalCloud, window_c: tuple[float, float] = WINDOW_C) -> PersonMask:
    """Find the person: by temperature, or by depth alone where there is none.

    window_c: surface temperatures of a person, degrees Celsius. Without a person the mask is empty and
    a note says so; that is no error.
    """
    if np.isfinite(cloud.temperature_c).any():
        return _by_temperature(cloud, window_c)
    return _by_depth(cloud)


def _by_temperature(cloud: ThermalCloud, window_c: tuple[float, float]) -> PersonMask:
    empty = np.zeros(cloud.depth_mm.shape, np.bool_)
    temperature, depth = cloud.temperature_c, cloud.points_m[..., 2]
    warm = cloud.valid & (temperature >= window_c[0]) & (temperature <= window_c[1])
    pieces = measure(cloud, *components(warm, depth))
    found = _likeliest(pieces)
    if found is None:
        low, high = window_c
        return PersonMask(empty, "thermal", (f"no person: nothing of human size is {low:g} to {high:g} C warm",))
    window = _surroundings(cloud, found)
    marks = _marks(cloud.valid[window], temperature[window], warm[window], window_c, _pixels(cloud, found, 0.15))
    reach = np.full(marks.shape, _pixels(cloud, found, 0.25), np.float32)
    marks = flood(marks, depth[window], reach)
    mask = empty.copy()
    mask[window] = marks == PERSON
    return PersonMask(_person_pieces(cloud, mask), "thermal")
