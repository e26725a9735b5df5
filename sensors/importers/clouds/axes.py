"""Axes of a cloud and place of its camera, found in the points.

Cloud files state neither axes nor camera. Points of one depth image lie in the cone that its camera sees,
with the camera at the origin: one axis alone has all of them in front. Other clouds are turned upright by
their floor, or by a person's height.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.importers.clouds.pixel_lattice import find_line

Float64 = NDArray[np.float64]

_X, _Y, _Z = np.eye(3)
AXES = {
    "camera": (_Z, -_Y),
    "y-up": (-_Z, _Y),
    "ros": (_X, _Z),
    "z-up": (_Y, _Z),
    "kinect": (_Z, _Y),
}
"""(forward, up) by name: a camera's own (ROS optical frame: x right, y down); OpenGL's; ROS' base_link and
camera_link (REP 103); maps'; the Kinect SDK's camera space. All are right-handed."""

WIDEST = 1.8
"""Tangent of half the widest field of a depth camera, with room: 60 degrees (Azure Kinect, WFOV)."""
INSIDE = 0.995
"""Share of the points that the camera at the origin must see; the rest may be flying pixels. Untuned."""
NARROWEST = 0.08
"""Least size of a cloud over its distance: a person 20 m away. Smaller clouds have the origin of a map."""
FLOOR_LEVEL = 0.25
"""Ratio of the origin's height over the lowest points to their distance, below which the origin lies on the
floor, as ROS' base_link does and no camera. Untuned."""
FLOOR_SHARE = 0.06
"""Least share of the points on a plane under all others that counts as a floor. Untuned."""
CLEARER = 2.5
"""Least ratio of the better floor to the second. Untuned."""
WIDE = 1.0
"""Tangent of half a field from which a camera at the origin needs evidence: wider than most cameras."""
PERSON_M = (0.8, 2.3)
"""Height of a whole person, in metres."""
HEAD_M, SHOULDERS_M = (0.02, 0.18), (0.28, 0.43)
"""Metres below the top of a person between which their head and their shoulders lie."""
HEAD_WIDTHS_M, SHOULDER_WIDTHS_M = (0.12, 0.26), (0.3, 0.6)
"""Widths of a head and of shoulders, in metres, from any side."""
HEAD_DEPTH_M = 0.22
"""Depth of the seen side of a head, in metres, at most: feet and raised arms have more. Untuned."""
ASIDE_M = (0.12, 0.2)
"""Metres by which a head is beside and in front of its shoulders, at most. Untuned."""
NECK = 1.6
"""Least width of shoulders over that of their head. Untuned."""
SAMPLE = 6000
"""Points of a cloud on which decisions rest. Untuned."""


class Cone(NamedTuple):
    """A view from the origin. name: of the axes. distance: median along the axis, in the file's unit.
    spread: mean tangent off the axis."""

    name: str
    distance: float
    spread: float


def camera_from(axes: str) -> Float64:
    """Return the rotation (3, 3) from a cloud's frame to the camera's: rows right, down, forward."""
    forward, up = AXES[axes]
    return np.stack([np.cross(forward, up), -up, forward])


def thinned(points: Float64, most: int = SAMPLE) -> Float64:
    """Return at most ``most`` of the points (n, 3), evenly over the file."""
    return points[:: max(1, -(-len(points) // most))]


def cone_of(
    points: Float64, names: tuple[str, ...] = ("camera", "y-up", "ros", "z-up"), anywhere: bool = False
) -> Cone | None:
    """Return the narrowest cone in which a camera at the origin sees all points (n, 3); None where none does.

    anywhere: whether the origin may lie on the floor, where no camera stands.
    """
    size = float(np.linalg.norm(np.ptp(np.percentile(points, (2, 98), axis=0), axis=0)))
    cones = []
    for name in names:
        turned = points @ camera_from(name).T
        ahead = turned[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.abs(turned[:, :2]).max(axis=1) / ahead
        seen = (ahead > 0) & (off < WIDEST)
        distance = float(np.median(ahead))
        if (
            seen.mean() < INSIDE
            or size < NARROWEST * distance
            or not (anywhere or not _on_the_floor(turned[seen], name))
        ):
            continue
        cones.append(Cone(name, distance, float(off[seen].mean())))
    return min(cones, key=lambda cone: cone.spread, default=None)


def on_pixels(points: Float64) -> bool:
    """Return whether camera-frame points (n, 3) lie on the pixels of a camera at the origin."""
    x, y, z = points[points[:, 2] > 0].T
    return find_line(x / z) is not None and find_line(y / z) is not None


def _on_the_floor(turned: Float64, name: str) -> bool:
    """Return whether the origin lies as low as the lowest points, where no camera stands.

    Points on the pixels of a camera at the origin are an exception, and so are a camera's own axes.
    """
    if name == "camera" or np.percentile(turned[:, 1], 99.5) >= FLOOR_LEVEL * np.percentile(turned[:, 2], 10):
        return False
    return not on_pixels(turned)


def credible(points_m: Float64, cone: Cone) -> bool:
    """Return whether a camera at the origin took the points (n, 3) that ``cone`` holds.

    A cone of WIDE and more holds any body above or beside the origin, as a scan centred on its own floor is:
    then the points must lie on a camera's pixels or show the floor or the ceiling of a room.
    """
    turned = points_m @ camera_from(cone.name).T
    ahead = turned[turned[:, 2] > 0]
    if np.percentile(np.abs(ahead[:, :2]).max(axis=1) / ahead[:, 2], 99) < WIDE or on_pixels(turned):
        return True
    return max(floor_share(turned, -_Y), floor_share(turned, _Y)) >= FLOOR_SHARE


def upright(points_m: Float64, name: str) -> tuple[str, bool]:
    """Return the axes ``name``, or "kinect" in place of "camera" where y points up; and their certainty.

    The floor or a person's head shows where y points; against a camera's axes a head alone is not sure.
    """
    if name != "camera":
        return name, True
    under, over = floor_share(points_m, -_Y), floor_share(points_m, _Y)
    if max(under, over) >= FLOOR_SHARE:
        if over >= FLOOR_SHARE and over > CLEARER * under:
            return "kinect", True
        return name, under > CLEARER * over
    above, below = _head(points_m), _head(-points_m)
    if above == below:
        return name, False
    return ("camera", True) if above else ("kinect", False)


def world_axes(points_m: Float64, mapped: bool) -> str | None:
    """Return the axes of a cloud whose origin is no camera; None = unknown.

    z is up in formats of maps (``mapped``); else the floor, a person's height, or the origin's cone decides.
    """
    if mapped:
        return "z-up"
    return _by_floor_or_person(points_m) or _by_cone(points_m)


def _by_cone(points_m: Float64) -> str | None:
    cone = cone_of(points_m, ("ros", "y-up", "z-up"), anywhere=True)
    return cone.name if cone is not None and credible(points_m, cone) else None


def _by_floor_or_person(points_m: Float64) -> str | None:
    floors = {
        "z-up": floor_share(points_m, _Z),
        "y-up": floor_share(points_m, _Y),
        "camera": floor_share(points_m, -_Y),
    }
    (best, most), (_, second) = sorted(floors.items(), key=lambda item: -item[1])[:2]
    if most < FLOOR_SHARE or most < CLEARER * second:
        x, y, z = np.ptp(np.percentile(points_m, (1, 99), axis=0), axis=0)
        tall = {"y-up": y, "z-up": z}
        best = max(tall, key=lambda axes: tall[axes])
        others = max(x, min(y, z))
        if not (PERSON_M[0] <= tall[best] <= PERSON_M[1] and tall[best] > 1.3 * others):
            return None
        if best == "y-up" and _head(points_m) and not _head(-points_m):
            return "camera"
    # A robot's sensor faces along x: its points have positive x.
    return "ros" if best == "z-up" and (points_m[:, 0] > 0).mean() >= INSIDE else best


def floor_share(points_m: Float64, up: Float64, seed: int = 0) -> float:
    """Return the share of the points on the largest plane below nearly all others, at most 35 degrees off.

    points_m: (n, 3). up: (3,). By random triples (RANSAC).
    """
    points = thinned(points_m, 3000)
    rng, best = np.random.default_rng(seed), 0.0
    if len(points) < 30:
        return best
    level = points - np.outer(points @ up, up)
    for _ in range(200):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if not length > 0 or abs(normal @ up) < 0.82 * length:
            continue
        normal *= np.sign(normal @ up) / length
        height = (points - a) @ normal
        on = np.abs(height) < 0.04
        if on.mean() > best and (height < -0.1).mean() < 0.03 and np.sort(level[on].std(axis=0))[1] > 0.3:
            best = float(on.mean())
    return best


def _head(points_m: Float64) -> bool:
    """Return whether a head on shoulders is at the end of the points (n, 3) where y is least."""
    down = points_m[:, 1] - np.percentile(points_m[:, 1], 0.5)
    head, shoulders = (points_m[(down >= top) & (down < end)] for top, end in (HEAD_M, SHOULDERS_M))
    if min(len(head), len(shoulders)) < 10:
        return False
    (width, depth), (broad, _) = (
        np.ptp(np.percentile(part[:, [0, 2]], (5, 95), axis=0), axis=0) for part in (head, shoulders)
    )
    aside = np.abs(np.median(head, axis=0) - np.median(shoulders, axis=0))
    return bool(
        HEAD_WIDTHS_M[0] < width < HEAD_WIDTHS_M[1]
        and SHOULDER_WIDTHS_M[0] < broad < SHOULDER_WIDTHS_M[1]
        and broad > NECK * width
        and depth < HEAD_DEPTH_M
        and aside[0] < ASIDE_M[0]
        and aside[2] < ASIDE_M[1]
    )
