"""Input channels of the suit network: bytes (n, h, w) over a rectangle around the subject.

Some channels hold the likelihood of a pixel's colour under each part's cloth in the frame's illuminant, so
one network serves any suit. Constants are untuned unless a source is given.
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
from annotate.parts import PAPER
from annotate.person.extract import PersonMask
from annotate.person.planes import Plane, distance_m
from annotate.scheme.merging import conversion_table
from annotate.scheme.scheme import Scheme
from annotate.suit.color_model import ColorModel, blur, evenly, readable
from annotate.suit.palette import chromaticity

MARGIN_M = 0.35  # m around the subject's rough outline: a cold lower leg, a hand on the arm rest
ARM_M = 1.1  # least m to each side of the outline's middle, because feet under a blanket are missing from it
LOCAL_PX = 31  # side of the window that a depth is compared with
RANGES = {
    "depth": (-1.0, 1.0),  # metres behind the subject's median
    "local": (-0.12, 0.12),  # metres behind its surroundings
    "off_plane": (-0.2, 0.2),  # metres from the nearest plane of the room
    "share": (-0.5, 1.5),  # of the way from the background's temperature to the person's
    "celsius": (-10.0, 10.0),  # degrees above the beginning of the person's window
    "shade": (-2.0, 2.0),  # log brightness against the rectangle's median
    "red": (-0.3, 0.3),  # chromaticity against the rectangle's median
    "green": (-0.3, 0.3),
    "room": (-2.5, 2.5),  # log odds of the person by colours learnt in the frame
}
"""Channels on a scale, with the values of their bytes 0 and 255."""
LOG_LIKELIHOOD = (-7.0, 2.0)  # values of the bytes 0 and 255 of a colour's log likelihood
UNKNOWN = -2.5  # log likelihood in the middle of these
SURE = np.float32(2.0)  # log odds of the rough outline, from which colours of person and room are learnt
VALID, FELT, SEEN, SUBJECT, OTHER = 1, 2, 4, 8, 16
"""Bits of the channel ``flags``: depth, temperature, readable colour, rough subject, other person."""
FIXED = ("flags", "before", *RANGES, "skin", "dark")
"""Channels in every scheme. ``before`` holds the classes of the previous frame; ``skin`` and ``dark`` (hair
or shoe) are log likelihoods of the colour, 0 = unknown."""


def channel_names(scheme: Scheme) -> tuple[str, ...]:
    """Return the names of all channels: ``FIXED``, and the log likelihoods as each part of the body."""
    return (*FIXED, *(part.name for part in scheme.parts if not part.is_free))


CHANNELS = channel_names(PAPER)
LIKELIHOODS = CHANNELS[FIXED.index("skin") :]
"""Channels of a colour's log likelihood."""


class Rectangle(NamedTuple):
    """Rectangle of an image, as slices of rows and columns."""

    rows: slice
    columns: slice

    def part(self, inner: "Rectangle") -> "Rectangle":
        """Return ``inner``, given relative to this rectangle, in pixels of the image."""
        sides = ((out.start, own) for out, own in zip(self, inner, strict=True))
        return Rectangle(*(slice(start + own.start, start + own.stop) for start, own in sides))


class Room(Protocol):
    """Planes and temperatures of a frame, e.g. ``PersonDetection``. share: (h, w), temperature relative to
    background (0) and person (1).
    """

    @property
    def planes(self) -> tuple[Plane, ...]: ...
    @property
    def share(self) -> Float32: ...
    @property
    def window_c(self) -> tuple[float, float]: ...


def rectangle(cloud: ThermalCloud, subject: Bool) -> tuple[Rectangle, float]:
    """Return the rectangle around a subject's coarse mask (h, w), not empty, and the pixels per metre at its
    depth.
    """
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
    """Return the channels uint8 (n, h, w) of a rectangle around the subject, as many as ``paper`` has.

    Likelihoods and previous parts are left 0; see ``with_likelihoods``, ``with_before`` and ``fitted_to``.
    """
    z, own = cloud.points_m[where][..., 2], person.mask[where]
    valid, celsius = cloud.valid[where], cloud.temperature_c[where]
    rgb = cloud.color_rgb[where]
    seen = valid & cloud.color_valid[where]
    if seen.any():
        seen &= readable(rgb.reshape(-1, 3), seen.ravel()).reshape(valid.shape)
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


def fitted_to(planes: UInt8, scheme: Scheme) -> UInt8:
    """Return channels with the number of likelihoods of a scheme; likelihoods are 0 in other numbers."""
    count = len(channel_names(scheme))
    if len(planes) == count:
        return planes
    made = np.zeros((count, *planes.shape[1:]), np.uint8)
    made[: len(FIXED)] = planes[: len(FIXED)]
    return made


def with_before(planes: UInt8, before: FrameLabels, where: Rectangle, scheme: Scheme = PAPER) -> UInt8:
    """Return channels (n, h, w) with the classes in a scheme of the previous frame in channel ``before``.

    Raises FormatError where that frame's scheme does not convert.
    """
    made = planes.copy()
    parts = before.parts[where]
    if before.scheme != scheme:
        parts = conversion_table(before.scheme, scheme)[parts]
    made[CHANNELS.index("before")] = scheme.class_table[parts]
    return made


def with_likelihoods(
    planes: UInt8, rgb: UInt8, illuminant: ColorModel, among: Bool | bool = True, scheme: Scheme = PAPER
) -> UInt8:
    """Return the channels (n, h, w) of a scheme with the likelihoods of colours (h, w, 3).

    among: bool (h, w), pixels to compute likelihoods for.
    """
    depth = planes[CHANNELS.index("depth")]
    wanted = np.flatnonzero(((planes[0] & SEEN) > 0) & (depth > 0) & (depth < 255) & among)
    own = rgb.reshape(-1, 3).take(wanted, axis=0)
    match = illuminant.match(chromaticity(own), blur(own))
    made = planes.copy()
    rows = (*match[illuminant.bare], *illuminant.by_part(match, scheme))
    for plane, likelihood in zip(made[FIXED.index("skin") :], rows, strict=True):
        _put(plane.reshape(-1), wanted, _bytes(likelihood, *LOG_LIKELIHOOD))
    return made


def with_evidence(planes: UInt8, rows: Float32, there: Bool) -> UInt8:
    """Return the channels (n, h, w) of ``paper`` with log likelihoods (m, h, w) of its parts from another
    source than colour.

    there: bool (h, w), pixels with likelihoods. Skin and dark cloth have the likelihood ``UNKNOWN``.
    """
    made = planes.copy()
    made[FIXED.index("skin") : len(FIXED)] = _bytes(np.full(there.shape, UNKNOWN), *LOG_LIKELIHOOD) * there
    made[len(FIXED) :] = np.maximum(_bytes(rows, *LOG_LIKELIHOOD), 1) * there
    return made


def _around_m(z: Float32, near: Bool) -> Float32:
    """Return the mean depth (h, w), metres, of the ``near`` pixels (bool (h, w)) in a window around each
    pixel.
    """
    total, count = (
        cv2.blur(np.where(near, plane, np.float32(0)), (LOCAL_PX, LOCAL_PX)) for plane in (z, np.ones_like(z))
    )
    return np.asarray(total / np.maximum(count, np.float32(1e-3)), np.float32)


def _colors(rgb: UInt8, seen: Bool) -> dict[str, Float64]:
    """Return brightness and chromaticity (h, w) of colours (h, w, 3), relative to the median over
    ``seen``.
    """
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
    """Scale values (...) from ``low`` to ``high`` to bytes 0 to 255; NaN becomes 128."""
    flat = np.ascontiguousarray(values, np.float32).ravel()
    return _scaled(flat, np.float32(low), np.float32(255 / (high - low))).reshape(values.shape)


@njit(cache=True, nogil=True)
def _scaled(values: Float32, low: np.float32, scale: np.float32) -> UInt8:
    """Return (values - low) * scale (n,), rounded and bounded to bytes; NaN becomes 128."""
    made = np.empty(len(values), np.uint8)
    for i in range(len(values)):
        byte = (values[i] - low) * scale + np.float32(0.5)
        made[i] = np.uint8(min(max(byte, np.float32(0)), np.float32(255))) if byte == byte else np.uint8(128)
    return made


@njit(cache=True, nogil=True)
def _put(made: UInt8, places: Index, values: UInt8) -> None:
    """Write values (n,) to places (n,), five times as fast as numpy."""
    for i in range(len(places)):
        made[places[i]] = values[i]


@njit(cache=True, nogil=True)
def write_one_hot(made: Float32, v: int, row: tuple[UInt8, UInt8], bits: tuple[int, ...], parts: int) -> None:
    """Write flags and labels (w,) as zeros and ones into row ``v`` of the first planes of ``made`` (m, h, w).

    row: flags, labels. bits: flags, in the planes' order. parts: number of parts; a plane of each follows.
    """
    flags, labels = row
    for i, bit in enumerate(bits):
        for u in range(len(flags)):
            made[i, v, u] = np.float32((flags[u] & bit) > 0)
    for part in range(1, parts + 1):
        for u in range(len(labels)):
            made[len(bits) + part - 1, v, u] = np.float32(labels[u] == part)


@njit(cache=True, nogil=True)
def network_input(planes: UInt8, parts: int) -> Float32:
    """Return the network's input float32 (m, h, w) for channels (n, h, w); flags and parts become one-hot
    planes.

    parts: number of parts of the scheme, things included. Unknown values are 0: temperature without a
    reading, unreadable colour.
    """
    count, height, width = planes.shape
    low, high = LOG_LIKELIHOOD
    neutral = np.float32(round(255 * low / (low - high)))
    bits = (VALID, FELT, SEEN, SUBJECT, OTHER)
    # The flag that makes each channel of ``RANGES`` valid.
    needed = (VALID, VALID, VALID, FELT, FELT, SEEN, SEEN, SEEN, SEEN)
    of_parts = 4 + len(needed)
    first, unit = len(bits) + parts, np.float32(1 / 64)
    made = np.zeros((first + count - 2, height, width), np.float32)
    flags, row, read = np.empty(width, np.uint8), np.empty(width, np.uint8), np.empty(width, np.uint8)
    for v in range(height):
        flags[:], read[:] = planes[0, v], 0  # copies side by side, so that the loops vectorise
        for i in range(of_parts, count):
            row[:] = planes[i, v]
            for u in range(width):
                read[u] |= row[u]
        row[:] = planes[1, v]
        write_one_hot(made, v, (flags, row), bits, parts)
        every, known = 0, 0
        for u in range(width):
            every, known = every | flags[u], known | read[u]
        for i, bit in enumerate(needed):
            row[:] = planes[2 + i, v]
            for u in range(width if every & bit else 0):
                value = (np.float32(row[u]) - np.float32(127.5)) * unit
                made[first + i, v, u] = value if flags[u] & bit else np.float32(0)
        for i in range(2 + len(needed), count if known else 0):
            row[:] = planes[i, v]
            for u in range(width):
                value = (np.float32(row[u]) - neutral) * unit
                made[first + i - 2, v, u] = value if read[u] else np.float32(0)
    return made
