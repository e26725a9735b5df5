"""What the reader of suits sees of a frame: bytes (24, h, w) over the rectangle around the subject.

Nothing here knows a colour of a suit: a channel says how well a pixel's colour fits a part's cloth in the
frame's light, whatever that cloth is. So one network reads any suit.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, UInt8
from annotate.cloud.color_odds import color_odds, lab_of
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.parts import BODY_PARTS
from annotate.person.extract import PersonMask, Survey
from annotate.person.planes import Plane
from annotate.suit.color_model import ColorModel, blur, readable
from annotate.suit.palette import chromaticity

MARGIN_M, ARM_M = 0.35, 1.1
"""Metres around the subject's rough outline that are looked at (a cold lower leg, a hand on the arm rest),
and to each side of its middle at least: feet seen below a blanket belong to no outline. Chosen by eye."""
LOCAL_PX = 31
"""Side in pixels of the window that a depth is compared with. Chosen by eye."""
SAMPLE_M, MOST_SAMPLES = 0.012, 256
"""Metres between two samples of what the network sees, as in its training, so that people have the same size
before every camera; samples along the longer side at most. Chosen by eye, for borders and for speed."""
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


def rectangle(cloud: ThermalCloud, subject: Bool) -> tuple[Rectangle, int]:
    """What is around a subject's rough outline (h, w), not empty; pixels between two samples."""
    pixels_per_m = cloud.camera.fx / float(np.median(cloud.points_m[..., 2][subject]))
    margin, arm = round(MARGIN_M * pixels_per_m), round(ARM_M * pixels_per_m)
    sides = []
    for axis, side in enumerate(subject.shape):
        seen = np.flatnonzero(subject.any(axis=1 - axis))
        first, last = int(seen[0]), int(seen[-1])
        middle = (first + last) // 2
        start, stop = min(first - margin, middle - arm), max(last + margin, middle + arm) + 1
        sides.append(slice(max(start, 0), min(stop, side)))
    longest = max(side.stop - side.start for side in sides)
    step = max(1, round(SAMPLE_M * pixels_per_m), -(-longest // MOST_SAMPLES))
    return Rectangle(*sides), step


def channels(
    cloud: ThermalCloud,
    survey: Survey,
    person: PersonMask,
    light: ColorModel | None,
    before: FrameLabels | None,
    where: Rectangle,
) -> UInt8:
    """Channels uint8 (24, h, w) in the order of ``CHANNELS``, of a rectangle's pixels around the subject.

    survey, person: of the same frame, found without the suit. light: the suit's colours in the frame's light;
    without, likeness is 0. before: labels of the previous frame.
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
        "off_plane": _off_planes_m(cloud.points_m[where], survey.planes),
        "share": survey.share[where],
        "celsius": celsius - np.float32(survey.window_c[0]),
        **(_colors(rgb, seen) if seen.any() else {}),
    }
    if seen.any():
        odds = np.where(own, SURE, -SURE).astype(np.float32)
        made["room"] = color_odds(lab_of(rgb, seen), odds, near, valid)
    planes = np.zeros((len(CHANNELS), *valid.shape), np.uint8)
    for name, values in made.items():
        planes[CHANNELS.index(name)] = _bytes(values, *RANGES[name])
    if before is not None and before.parts.shape == cloud.valid.shape:
        planes[CHANNELS.index("before")] = before.parts[where]
    flags = ((VALID, valid), (FELT, valid & np.isfinite(celsius)), (SEEN, seen), (SUBJECT, own))
    for bit, there in (*flags, (OTHER, person.others[where])):
        planes[0] += np.uint8(bit) * there
    return planes if light is None else relit(planes, light, rgb)


def relit(planes: UInt8, light: ColorModel, rgb: UInt8) -> UInt8:
    """Channels (24, h, w) of colours (h, w, 3) in another light: all but the likeness as in ``planes``."""
    depth = planes[CHANNELS.index("depth")]
    asked = ((planes[0] & SEEN) > 0) & (depth > 0) & (depth < 255)
    match = light.match(chromaticity(rgb[asked]), blur(rgb[asked]))
    likeness = np.concatenate([match[:, light.bare], light.by_part(match)], axis=1).T
    made = planes.copy()
    made[-len(LIKENESS) :, asked] = _bytes(likeness, *LOG_LIKELIHOOD)
    return made


def _around_m(z: Float32, near: Bool) -> Float32:
    """Mean depth (h, w) around each pixel, of what is near."""
    total, count = (
        cv2.blur(np.where(near, plane, np.float32(0)), (LOCAL_PX, LOCAL_PX)) for plane in (z, np.ones_like(z))
    )
    return np.asarray(total / np.maximum(count, np.float32(1e-3)), np.float32)


def _off_planes_m(points_m: Float32, planes: tuple[Plane, ...]) -> Float32:
    """Metres (h, w) from the nearest plane of the room, bounded."""
    off_m = np.full(points_m.shape[:2], RANGES["off_plane"][1], np.float32)
    for plane in planes:
        np.fmin(off_m, np.abs(points_m @ plane.normal - np.float32(plane.offset_m)), out=off_m)
    return off_m


def _colors(rgb: UInt8, seen: Bool) -> dict[str, NDArray[np.floating]]:
    """Shade and chromaticity (h, w) of colours (h, w, 3) against the median of those seen."""
    brightest = np.maximum(np.maximum(rgb[..., 0], rgb[..., 1]), rgb[..., 2])
    usual = max(float(np.median(brightest[seen])), 1.0)
    made: dict[str, NDArray[np.floating]] = {"shade": np.log(np.maximum(brightest, 1) / usual)}
    chroma = chromaticity(rgb[seen])
    for name, own in zip(("red", "green"), chroma.T, strict=True):
        made[name] = np.zeros(seen.shape)
        made[name][seen] = own - np.median(own)
    return made


def _bytes(values: NDArray[np.floating], low: float, high: float) -> UInt8:
    """Values (...) as bytes, those from ``low`` to ``high`` as 0 to 255, NaN in the middle."""
    scaled = (np.asarray(values, np.float32) - np.float32(low)) * np.float32(255 / (high - low))
    scaled = np.where(np.isnan(scaled), np.float32(127.5), scaled)
    return np.asarray(np.clip(scaled + np.float32(0.5), 0, 255), np.uint8)


def network_input(planes: UInt8) -> Float32:
    """Input float32 (38, h, w) of the network from channels (24, h, w): flags and parts one by one.

    What is not known is 0: temperature where none is felt, colour where none is readable.
    """
    count = len(RANGES)
    flags = [(planes[0] & bit) > 0 for bit in (VALID, FELT, SEEN, SUBJECT, OTHER)]
    before = [planes[1] == part.id for part in BODY_PARTS]
    scaled = (planes[2 : 2 + count].astype(np.float32) - np.float32(127.5)) / np.float32(64)
    scaled[:3] *= flags[0]
    scaled[3:5] *= flags[1]
    scaled[5:] *= flags[2]
    likeness = planes[2 + count :]
    least, most = LOG_LIKELIHOOD
    neutral = np.float32(round(-255 * least / (most - least)))
    known = likeness[2:].max(axis=0) > 0
    read = (likeness.astype(np.float32) - neutral) / np.float32(64) * known
    return np.concatenate([np.stack([*flags, *before]).astype(np.float32), scaled, read])
