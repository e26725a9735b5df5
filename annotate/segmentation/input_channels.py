"""What the reader of suits sees of a frame: bytes (24, h, w) over the rectangle around the subject.

Nothing here knows a colour of a suit: a channel says how well a pixel's colour fits a part's cloth in the
frame's light, whatever that cloth is. So one network reads any suit.
"""

from typing import NamedTuple, Protocol

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, Float64, Index, UInt8
from annotate.cloud.color_odds import color_odds, lab_of
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.parts import BODY_PARTS, N_CLASSES
from annotate.person.extract import PersonMask
from annotate.person.planes import Plane, distance_m
from annotate.suit.color_model import ColorModel, blur, evenly, readable
from annotate.suit.palette import chromaticity

MARGIN_M, ARM_M = 0.35, 1.1
"""Metres around the subject's rough outline that are looked at (a cold lower leg, a hand on the arm rest),
and to each side of its middle at least: feet seen below a blanket belong to no outline. Chosen by eye."""
LOCAL_PX = 31
"""Side in pixels of the window that a depth is compared with. Chosen by eye."""
RANGES = {
    "depth": (-1.0, 1.0),  # metres behind the subject's median
    "local": (-0.12, 0.12),  # metres behind what is around
    "off_plane": (-0.2, 0.2),  # metres from the nearest plane of the room
    "share": (-0.5, 1.5),  # of the way from the background's temperature to the person's
    "celsius": (-10.0, 10.0),  # degrees above the beginning of the person's window
    "shade": (-2.0, 2.0),  # log brightness against the rectangle's median
    "red": (-0.3, 0.3),  # chromaticity against the rectangle's median
    "green": (-0.3, 0.3),
    "room": (-2.5, 2.5),  # log odds of the person by colours learnt in the frame
}
"""Channels on a scale, with the values of their bytes 0 and 255. Chosen by eye."""
LOG_LIKELIHOOD = (-7.0, 2.0)
"""Values of the bytes 0 and 255 of a colour's log likelihood. Chosen by eye."""
SURE = np.float32(2.0)
"""Log odds of the rough outline, from which the colours of person and room are learnt. Chosen by eye."""
VALID, FELT, SEEN, SUBJECT, OTHER = 1, 2, 4, 8, 16
"""Bits of the channel ``flags``: depth, temperature, readable colour; roughly the subject's, another's."""
LIKENESS = ("skin", "dark", *(part.name for part in BODY_PARTS))
"""Channels of a colour's log likelihood: as skin, as hair or shoe, as what each part shows; 0 = not read."""
CHANNELS = ("flags", "before", *RANGES, *LIKENESS)
"""All channels; ``before`` holds the parts of the frame before."""


class Rectangle(NamedTuple):
    """Rows and columns of an image."""

    rows: slice
    columns: slice

    def part(self, inner: "Rectangle") -> "Rectangle":
        """Rows and columns of a rectangle within this one, in the image."""
        sides = ((out.start, own) for out, own in zip(self, inner, strict=True))
        return Rectangle(*(slice(start + own.start, start + own.stop) for start, own in sides))


class Room(Protocol):
    """What is known of a frame's room: its planes, the share (h, w) of the way from the background's
    temperature to the person's, and the temperatures of a person, degrees Celsius."""

    @property
    def planes(self) -> tuple[Plane, ...]: ...
    @property
    def share(self) -> Float32: ...
    @property
    def window_c(self) -> tuple[float, float]: ...


def rectangle(cloud: ThermalCloud, subject: Bool) -> tuple[Rectangle, float]:
    """What is around a subject's rough outline (h, w), not empty; pixels per metre there."""
    pixels_per_m = cloud.camera.fx / float(np.median(cloud.points_m[..., 2][subject]))
    margin, arm = round(MARGIN_M * pixels_per_m), round(ARM_M * pixels_per_m)
    sides = []
    for axis, side in enumerate(subject.shape):
        seen = np.flatnonzero(subject.any(axis=1 - axis))
        first, last = int(seen[0]), int(seen[-1])
        middle = (first + last) // 2
        start, stop = min(first - margin, middle - arm), max(last + margin, middle + arm) + 1
        sides.append(slice(max(start, 0), min(stop, side)))
    return Rectangle(*sides), pixels_per_m


def channels(cloud: ThermalCloud, room: Room, person: PersonMask, where: Rectangle) -> UInt8:
    """Channels uint8 (24, h, w) in the order of ``CHANNELS``, of a rectangle's pixels around the subject.

    room, person: of the same frame, found without the suit. The likeness is 0: it is ``in_light``; so are
    the parts before: they are ``with_before``.
    """
    z, own = cloud.points_m[where][..., 2], person.mask[where]
    valid, celsius = cloud.valid[where], cloud.temperature_c[where]
    rgb = cloud.color_rgb[where]
    seen = valid & readable(rgb.reshape(-1, 3), cloud.color_valid[where].ravel()).reshape(valid.shape)
    middle_m = float(np.median(z[own]))
    near = valid & (np.abs(z - middle_m) < RANGES["depth"][1])
    made = {
        "depth": z - middle_m,
        "local": z - _around_m(z, near),
        "off_plane": distance_m(room.planes, cloud.points_m[where]),
        "share": room.share[where],
        "celsius": celsius - np.float32(room.window_c[0]),
        **(_colors(rgb, seen) if seen.any() else {}),
    }
    if seen.any():
        odds = np.where(own, SURE, -SURE).astype(np.float32)
        made["room"] = color_odds(lab_of(rgb, seen), odds, near, valid)
    planes = np.zeros((len(CHANNELS), *valid.shape), np.uint8)
    for name, values in made.items():
        planes[CHANNELS.index(name)] = _bytes(values, *RANGES[name])
    flags = ((VALID, valid), (FELT, valid & np.isfinite(celsius)), (SEEN, seen), (SUBJECT, own))
    for bit, there in (*flags, (OTHER, person.others[where])):
        planes[0] += np.uint8(bit) * there
    return planes


def with_before(planes: UInt8, before: FrameLabels, where: Rectangle) -> UInt8:
    """Channels (24, h, w) of a rectangle with the parts of the frame before; the others as in ``planes``."""
    made = planes.copy()
    made[CHANNELS.index("before")] = before.parts[where]
    return made


def in_light(planes: UInt8, rgb: UInt8, light: ColorModel, among: Bool | bool = True) -> UInt8:
    """Channels (24, h, w) with the likeness of colours (h, w, 3) in a light; the others as in ``planes``.

    among: bool (h, w), pixels whose likeness is wanted.
    """
    depth = planes[CHANNELS.index("depth")]
    wanted = np.flatnonzero(((planes[0] & SEEN) > 0) & (depth > 0) & (depth < 255) & among)
    own = rgb.reshape(-1, 3).take(wanted, axis=0)
    match = light.match(chromaticity(own), blur(own))
    made = planes.copy()
    rows = (*match[light.bare], *light.by_part(match))
    for plane, likeness in zip(made[-len(LIKENESS) :], rows, strict=True):
        _put(plane.reshape(-1), wanted, _bytes(likeness, *LOG_LIKELIHOOD))
    return made


def _around_m(z: Float32, near: Bool) -> Float32:
    """Mean depth (h, w) around each pixel, of what is near."""
    total, count = (
        cv2.blur(np.where(near, plane, np.float32(0)), (LOCAL_PX, LOCAL_PX)) for plane in (z, np.ones_like(z))
    )
    return np.asarray(total / np.maximum(count, np.float32(1e-3)), np.float32)


def _colors(rgb: UInt8, seen: Bool) -> dict[str, Float64]:
    """Shade and chromaticity (h, w) of colours (h, w, 3) against the median of those seen, any."""
    brightest, chroma = np.maximum(np.maximum(rgb[..., 0], rgb[..., 1]), rgb[..., 2]), chromaticity(rgb)
    some = np.flatnonzero(seen)
    some = some[evenly(len(some))]
    usual, red, green = (
        float(np.median(values.take(some))) for values in (brightest, chroma[..., 0], chroma[..., 1])
    )
    shade = np.log(np.maximum(np.arange(256), 1) / max(usual, 1.0))
    return {
        "shade": shade[brightest],
        "red": np.where(seen, chroma[..., 0] - red, 0),
        "green": np.where(seen, chroma[..., 1] - green, 0),
    }


def _bytes(values: NDArray[np.floating], low: float, high: float) -> UInt8:
    """Values (...) as bytes, those from ``low`` to ``high`` as 0 to 255, NaN in the middle."""
    flat = np.ascontiguousarray(values, np.float32).ravel()
    return _scaled(flat, np.float32(low), np.float32(255 / (high - low))).reshape(values.shape)


@njit(cache=True, nogil=True)
def _scaled(values: Float32, low: np.float32, scale: np.float32) -> UInt8:
    """Bytes (n,) of values (n,): (value - low) * scale, rounded and bounded; NaN in the middle."""
    made = np.empty(len(values), np.uint8)
    for i in range(len(values)):
        byte = (values[i] - low) * scale + np.float32(0.5)
        made[i] = np.uint8(min(max(byte, np.float32(0)), np.float32(255))) if byte == byte else np.uint8(128)
    return made


@njit(cache=True, nogil=True)
def _put(made: UInt8, places: Index, values: UInt8) -> None:
    """Write values (n,) to places (n,); a fifth of the time of numpy's."""
    for i in range(len(places)):
        made[places[i]] = values[i]


@njit(cache=True, nogil=True)
def network_input(planes: UInt8) -> Float32:
    """Input float32 (38, h, w) of the network from channels (24, h, w): flags and parts one by one.

    What is not known is 0: temperature where none is felt, colour where none is readable.
    """
    count, height, width = planes.shape
    low, high = LOG_LIKELIHOOD
    neutral = np.float32(round(255 * low / (low - high)))
    bits = (VALID, FELT, SEEN, SUBJECT, OTHER)
    # The flag without which a channel of ``RANGES`` says nothing.
    needed = (VALID, VALID, VALID, FELT, FELT, SEEN, SEEN, SEEN, SEEN)
    first, unit = len(bits) + N_CLASSES - 1, np.float32(1 / 64)
    made = np.empty((first + count - 2, height, width), np.float32)
    row, read = np.empty((count, width), np.uint8), np.empty(width, np.uint8)
    for v in range(height):
        row[:], read[:] = planes[:, v], 0  # a copy side by side, so that the loops vectorise
        for i in range(count + 1 - N_CLASSES, count):
            for u in range(width):
                read[u] |= row[i, u]
        for i, bit in enumerate(bits):
            for u in range(width):
                made[i, v, u] = np.float32((row[0, u] & bit) > 0)
        for part in range(1, N_CLASSES):
            for u in range(width):
                made[len(bits) + part - 1, v, u] = np.float32(row[1, u] == part)
        for i, bit in enumerate(needed):
            for u in range(width):
                value = (np.float32(row[2 + i, u]) - np.float32(127.5)) * unit
                made[first + i, v, u] = value if row[0, u] & bit else np.float32(0)
        for i in range(2 + len(needed), count):
            for u in range(width):
                value = (np.float32(row[i, u]) - neutral) * unit
                made[first + i - 2, v, u] = value if read[u] else np.float32(0)
    return made
