"""Evidence of a person's joints in part labels: where parts border on each other, and where each one lies.

A joint lies between two parts, so the middle of their border, pushed from the surface into the body, is a
measurement of it; the middle of a limb's surface, pushed in likewise, lies a known share of the way from
one of the limb's joints to the other. ``skeleton_fit`` makes a skeleton of these.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from annotate.array_types import Float64, Int64, UInt8, UInt16
from annotate.crop import window_of
from annotate.parts import BACKGROUND, N_CLASSES, PART_ID, on_body
from sensors.rig.camera import Intrinsics
from synth.body.skeleton import JOINT_ID

_SIDED = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
JOINT_NAMES = ("head", "neck", "pelvis", *(f"{side}_{kind}" for side in ("left", "right") for kind in _SIDED))
"""Joints of `synth.body.skeleton` that lie on the border or in the middle of a part, the clavicles' aside."""
N_JOINTS = len(JOINT_NAMES)
JOINT = {name: i for i, name in enumerate(JOINT_NAMES)}
TWIN = np.array(
    [
        JOINT_NAMES.index(name.replace("left", "right") if "left" in name else name.replace("right", "left"))
        for name in JOINT_NAMES
    ]
)
"""Index of each joint's twin on the other side; a middle one is its own."""
IN_SKELETON = np.array([JOINT_ID[name] for name in JOINT_NAMES])
"""Index of each among the skeleton's, as a label set's notes list them."""

BANDWIDTH_MM = 65.0
"""Of the mean shift that finds where most of a border's points lie (Shotton et al. 2011: 0.065 m)."""
JUMP_MM = 60.0
"""Neighbours further apart in depth hide each other and do not touch; chosen by eye."""
BORDER_PIXELS, PART_PIXELS = 6, 20
"""Pixels of the smallest border and the smallest part that count; chosen by eye."""
PART_POINTS = 500
"""Points of a part at most, evenly chosen: for speed; chosen by eye."""
STEPS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))
"""Neighbours (dv, du) compared: a line of pixels that nobody labelled may lie between; chosen by eye."""
_END = 0.05
"""Share of a part that is its end; chosen by eye."""


@dataclass(frozen=True)
class Hinge:
    """A joint between two parts. push_mm: how far it lies behind the border's surface, along the ray.

    sigma_mm: standard deviation of what is left then, per axis. Both fitted by tools/fit/joints.py.
    """

    joint: str
    parts: tuple[str, str]
    push_mm: float
    sigma_mm: float


@dataclass(frozen=True)
class Limb:
    """A part that lies along a line. joints: the line's ends; share: how far along it the part's middle lies.

    push_mm, sigma_mm: as a ``Hinge``'s, of the middle.
    """

    part: str
    joints: tuple[str, str]
    share: float
    push_mm: float
    sigma_mm: float


_BOTH = ("left", "right")
HINGES = (
    Hinge("neck", ("head", "torso"), 49, 17),
    *(Hinge(f"{s}_shoulder", ("torso", f"{s}_upper_arm"), 41, 24) for s in _BOTH),
    *(Hinge(f"{s}_elbow", (f"{s}_upper_arm", f"{s}_forearm"), 31, 18) for s in _BOTH),
    *(Hinge(f"{s}_hip", ("hip", f"{s}_upper_leg"), 83, 40) for s in _BOTH),
    *(Hinge(f"{s}_knee", (f"{s}_upper_leg", f"{s}_lower_leg"), 41, 19) for s in _BOTH),
)
LIMBS = (
    Limb("head", ("neck", "head"), 1.18, 71, 15),
    Limb("torso", ("neck", "pelvis"), 0.40, 106, 27),
    Limb("hip", ("pelvis", "neck"), 0.04, 97, 38),
    *(Limb(f"{s}_upper_arm", (f"{s}_shoulder", f"{s}_elbow"), 0.40, 37, 18) for s in _BOTH),
    *(Limb(f"{s}_forearm", (f"{s}_elbow", f"{s}_wrist"), 0.77, 25, 22) for s in _BOTH),
    *(Limb(f"{s}_upper_leg", (f"{s}_hip", f"{s}_knee"), 0.59, 83, 24) for s in _BOTH),
    *(Limb(f"{s}_lower_leg", (f"{s}_knee", f"{s}_ankle"), 0.67, 30, 24) for s in _BOTH),
)


def _by_parts() -> Int64:
    table = np.full((N_CLASSES, N_CLASSES), -1)
    for i, hinge in enumerate(HINGES):
        a, b = (PART_ID[part] for part in hinge.parts)
        table[a, b] = table[b, a] = i
    return table


HINGE = _by_parts()
"""Index among HINGES of the hinge between two parts' ids (12, 12), -1 without one."""

EVIDENCE = np.dtype(
    [
        ("borders", np.float64, (len(HINGES), 3)),
        ("middles", np.float64, (len(LIMBS), 3)),
        ("direct", np.bool_, len(HINGES)),
    ]
)
"""What a frame shows of the joints, depth camera's frame, millimetres, NaN where it shows nothing.

borders: surface points by HINGES. middles: middles of the parts by LIMBS. direct: False where a border is
hidden and the parts' ends stand in for it.
"""

Evidence = NDArray[np.void]


def joint_evidence(parts: UInt8, depth_mm: UInt16, camera: Intrinsics) -> Evidence:
    """EVIDENCE (): borders and middles of parts (h, w) over a depth image (h, w) of an undistorted camera."""
    found = np.zeros((), EVIDENCE)
    borders, middles, direct = found["borders"], found["middles"], found["direct"]
    borders[:], middles[:] = np.nan, np.nan
    window = window_of(on_body(parts))
    depth = depth_mm[window]
    labels = np.where(on_body(parts[window]) & (depth > 0), parts[window], np.uint8(BACKGROUND))
    if not labels.any():
        return found
    rays = _rays(camera, window)
    of_part = _by_part(labels, depth, rays)
    for i, limb in enumerate(LIMBS):
        if len(of_part[limb.part]) >= PART_PIXELS:
            middles[i] = _median(of_part[limb.part])
    which, middles_mm = crossings(labels, depth, *rays, HINGE, np.array(STEPS))
    for i, hinge in enumerate(HINGES):
        a, b = hinge.parts
        on_border = middles_mm[which == i]
        direct[i] = len(on_border) >= BORDER_PIXELS
        if direct[i]:
            borders[i] = _mode(on_border, _median(on_border))
        elif min(len(of_part[a]), len(of_part[b])) >= PART_PIXELS:
            borders[i] = _between(of_part[a], of_part[b])
    return found


def _rays(camera: Intrinsics, window: tuple[slice, slice]) -> tuple[Float64, Float64]:
    """x / z of a window's columns (w,) and y / z of its rows (h,)."""
    rows, columns = (np.arange(side.start, side.stop) for side in window)
    return (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy


def _by_part(labels: UInt8, depth_mm: UInt16, rays: tuple[Float64, Float64]) -> dict[str, Float64]:
    """Points (n, 3) of every part by name, at most PART_POINTS, evenly chosen. rays: of ``_rays``."""
    index = np.flatnonzero(labels)
    label = labels.ravel()[index]
    index = index[np.argsort(label, kind="stable")]
    ends = np.cumsum(np.bincount(label, minlength=N_CLASSES))
    chosen = []
    for limb in LIMBS:
        first, end = ends[PART_ID[limb.part] - 1], ends[PART_ID[limb.part]]
        chosen.append(index[first : end : (end - first) // PART_POINTS + 1])
    v, u = np.divmod(np.concatenate(chosen), labels.shape[1])
    depth = depth_mm[v, u]
    points = np.stack([rays[0][u] * depth, rays[1][v] * depth, depth], axis=-1)
    of_each = np.split(points, np.cumsum([len(own) for own in chosen])[:-1])
    return {limb.part: own for limb, own in zip(LIMBS, of_each, strict=True)}


@njit(cache=True, nogil=True)
def crossings(
    labels: UInt8, depth_mm: UInt16, x_z: Float64, y_z: Float64, hinge: Int64, steps: Int64
) -> tuple[Int64, Float64]:
    """Neighbouring pixels of a hinge's two parts that touch: its index (n,) and the midpoint (n, 3) of each.

    x_z (w,), y_z (h,): the pixels' rays. hinge: HINGE (12, 12). steps: STEPS (S, 2).
    """
    height, width = labels.shape
    which, middles = np.empty(len(steps) * labels.size, np.int64), np.empty((len(steps) * labels.size, 3))
    n = 0
    for dv, du in steps:
        for v in range(height - dv):
            for u in range(max(0, -du), width - max(0, du)):
                own, other = labels[v, u], labels[v + dv, u + du]
                if own == other or hinge[own, other] < 0:
                    continue
                a, b = float(depth_mm[v, u]), float(depth_mm[v + dv, u + du])
                if abs(a - b) < JUMP_MM:
                    which[n] = hinge[own, other]
                    middles[n, 0] = (x_z[u] * a + x_z[u + du] * b) / 2
                    middles[n, 1] = (y_z[v] * a + y_z[v + dv] * b) / 2
                    middles[n, 2] = (a + b) / 2
                    n += 1
    return which[:n].copy(), middles[:n].copy()


def _median(points_mm: Float64) -> Float64:
    """Median (3,) of points (n, 3), n > 0, by coordinate: as of NumPy, whose own takes twice the time."""
    below, above = (len(points_mm) - 1) // 2, len(points_mm) // 2
    ordered = np.partition(points_mm, (below, above), axis=0)
    return np.asarray((ordered[below] + ordered[above]) / 2, np.float64)


def _between(a_mm: Float64, b_mm: Float64) -> Float64:
    """Between the ends that two parts (n, 3), (m, 3) which do not touch turn to each other."""
    axis = _median(b_mm) - _median(a_mm)
    along_a, along_b = a_mm @ axis, b_mm @ axis
    end_a = a_mm[along_a >= np.quantile(along_a, 1 - _END)].mean(axis=0)
    end_b = b_mm[along_b <= np.quantile(along_b, _END)].mean(axis=0)
    return np.asarray((end_a + end_b) / 2, np.float64)


def _mode(points_mm: Float64, start_mm: Float64) -> Float64:
    """Mean shift with a Gaussian kernel from ``start_mm`` to where most points (n, 3) lie."""
    mode = start_mm
    for _ in range(10):
        weight = np.exp(-0.5 * np.square((points_mm - mode) / BANDWIDTH_MM).sum(axis=1))
        if not weight.sum() > 0:
            return start_mm
        before, mode = mode, weight @ points_mm / weight.sum()
        if np.abs(mode - before).max() < 1:
            break
    return mode


def pushed(points_mm: Float64, push_mm: Float64 | float) -> Float64:
    """Surface points (..., 3) moved into the body: away from the camera along their rays."""
    return np.asarray(points_mm * (1 + push_mm / np.linalg.norm(points_mm, axis=-1))[..., None])
