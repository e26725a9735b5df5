"""Detection of a cloud's axes from its points, because cloud files state neither axes nor camera.

Points of one depth image lie in the viewing cone of a camera at the origin. Only one axis has all of them in
front. Other clouds are turned upright by the floor or by a person's height. Constants are untuned unless a
source is given.
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
WIDEST = 1.8  # tangent of half the widest field, with room: 60 degrees (Azure Kinect, WFOV)
INSIDE = 0.995  # share of the points within a camera's field; the rest may be flying pixels
NARROWEST = 0.08  # least size of a cloud over its distance: a person at 20 m; maps have less
FLOOR_LEVEL = 0.25  # ratio of height to distance of the lowest points below which the origin is on the floor
FLOOR_SHARE = 0.06  # least share of the points on a plane under all others that counts as a floor
CLEARER = 2.5  # least ratio of the better floor to the second
WIDE = 1.0  # tangent of half a field from which a camera at the origin needs evidence: wider than most
PERSON_M = (0.8, 2.3)  # height of a whole person
HEAD_M, SHOULDERS_M = (0.02, 0.18), (0.28, 0.43)  # below the top of a person
HEAD_WIDTHS_M, SHOULDER_WIDTHS_M = (0.12, 0.26), (0.3, 0.6)  # from any side
HEAD_DEPTH_M = 0.22  # depth of the visible side of a head, at most: feet and raised arms have more
ASIDE_M = (0.12, 0.2)  # most that a head is beside and in front of its shoulders
NECK = 1.6  # least width of shoulders over the width of their head
SAMPLE = 6000  # points on which decisions rest


class Cone(NamedTuple):
    """Viewing cone from the origin.

    name: of the axes. distance: median along the axis, in the file's unit. spread: mean tangent of the angle
    off the axis.
    """

    name: str
    distance: float
    spread: float


def camera_from(axes: str) -> Float64:
    """Return the rotation (3, 3) from a cloud's frame to the camera's: rows right, down, forward."""
    forward, up = AXES[axes]
    return np.stack([np.cross(forward, up), -up, forward])


def subsample(points: Float64, most: int = SAMPLE) -> Float64:
    """Return at most ``most`` of the points (n, 3), evenly over the file."""
    return points[:: max(1, -(-len(points) // most))]


def narrowest_cone(
    points: Float64, names: tuple[str, ...] = ("camera", "y-up", "ros", "z-up"), anywhere: bool = False
) -> Cone | None:
    """Return the narrowest cone of a camera at the origin with all points (n, 3); None without one.

    anywhere: True to allow an origin on the floor, where no camera stands.
    """
    size = float(np.linalg.norm(np.ptp(np.percentile(points, (2, 98), axis=0), axis=0)))
    cones = []
    for name in names:
        turned = points @ camera_from(name).T
        ahead = turned[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.abs(turned[:, :2]).max(axis=1) / ahead
        inside = (ahead > 0) & (off < WIDEST)
        distance = float(np.median(ahead))
        if inside.mean() < INSIDE or size < NARROWEST * distance:
            continue
        if anywhere or not _is_on_floor(turned[inside], name):
            cones.append(Cone(name, distance, float(off[inside].mean())))
    return min(cones, key=lambda cone: cone.spread, default=None)


def on_pixels(points: Float64) -> bool:
    """Return whether camera-frame points (n, 3) lie on pixel rays of a camera at the origin."""
    x, y, z = points[points[:, 2] > 0].T
    return find_line(x / z) is not None and find_line(y / z) is not None


def _is_on_floor(turned: Float64, name: str) -> bool:
    """Return whether the origin is as low as the lowest points, as ROS' base_link is and a camera is not.

    Returns False for points on pixel rays of a camera at the origin, and for a camera's own axes.
    """
    if name == "camera" or np.percentile(turned[:, 1], 99.5) >= FLOOR_LEVEL * np.percentile(turned[:, 2], 10):
        return False
    return not on_pixels(turned)


def is_credible(points_m: Float64, cone: Cone) -> bool:
    """Return whether a camera at the origin can have recorded the points (n, 3) in ``cone``.

    A cone of at least WIDE contains any body above or beside the origin, for example a scan centred on its
    own floor. The points in such a cone must lie on pixel rays, or show the floor or the ceiling of a room.
    """
    turned = points_m @ camera_from(cone.name).T
    ahead = turned[turned[:, 2] > 0]
    if np.percentile(np.abs(ahead[:, :2]).max(axis=1) / ahead[:, 2], 99) < WIDE or on_pixels(turned):
        return True
    return max(floor_share(turned, -_Y), floor_share(turned, _Y)) >= FLOOR_SHARE


def upright_axes(points_m: Float64, name: str) -> tuple[str, bool]:
    """Return the axes with y down, and True if they are certain.

    Returns "kinect" in place of "camera" where y points up. The floor or a person's head shows the direction
    of y; a head alone that contradicts a camera's axes is not certain.
    """
    if name != "camera":
        return name, True
    under, over = floor_share(points_m, -_Y), floor_share(points_m, _Y)
    if max(under, over) >= FLOOR_SHARE:
        if over >= FLOOR_SHARE and over > CLEARER * under:
            return "kinect", True
        return name, under > CLEARER * over
    above, below = _has_head(points_m), _has_head(-points_m)
    if above == below:
        return name, False
    return ("camera", True) if above else ("kinect", False)


def world_axes(points_m: Float64, mapped: bool) -> str | None:
    """Return the axes of a cloud whose origin is not its camera; None = unknown.

    mapped: True for file formats of maps, whose z is up. Otherwise the floor, a person's height, or the
    origin's cone decides.
    """
    if mapped:
        return "z-up"
    if (found := _axes_by_floor_or_person(points_m)) is not None:
        return found
    cone = narrowest_cone(points_m, ("ros", "y-up", "z-up"), anywhere=True)
    return cone.name if cone is not None and is_credible(points_m, cone) else None


def _axes_by_floor_or_person(points_m: Float64) -> str | None:
    floors = {name: floor_share(points_m, up) for name, up in (("z-up", _Z), ("y-up", _Y), ("camera", -_Y))}
    (best, most), (_, second) = sorted(floors.items(), key=lambda item: -item[1])[:2]
    if most < FLOOR_SHARE or most < CLEARER * second:
        x, y, z = np.ptp(np.percentile(points_m, (1, 99), axis=0), axis=0)
        best, height = ("z-up", z) if z > y else ("y-up", y)
        if not (PERSON_M[0] <= height <= PERSON_M[1] and height > 1.3 * max(x, min(y, z))):
            return None
        if best == "y-up" and _has_head(points_m) and not _has_head(-points_m):
            return "camera"
    # A robot's sensor faces along x: its points have positive x.
    return "ros" if best == "z-up" and (points_m[:, 0] > 0).mean() >= INSIDE else best


def floor_share(points_m: Float64, up: Float64) -> float:
    """Return the share of the points (n, 3) on the largest plane below nearly all others, by RANSAC.

    The plane is at most 35 degrees off ``up`` (3,).
    """
    points = subsample(points_m, 3000)
    rng, best = np.random.default_rng(0), 0.0
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


def _has_head(points_m: Float64) -> bool:
    """Return whether the points (n, 3) with the least y have the shape of a head on shoulders."""
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
