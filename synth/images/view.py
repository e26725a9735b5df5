"""Depth camera's view of a person among furniture: parts, depth and occlusion."""

from dataclasses import dataclass, replace

import numba
import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Bool, Float32, Float64, Int32, Int64, UInt8
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose
from synth.clothes.dressed import Dressed
from synth.surface.furniture import Surface
from synth.surface.rasterize import NEAR_M, Mesh, box, rasterize

BORDER_PX = 4  # around the person, so that edges and slopes have neighbours
THING_M = (0.04, 0.45)  # edge lengths of an occluder, from a pole to a chair's back


@dataclass(frozen=True)
class PersonView:
    """Window (h, w) of the depth image around the person, without noise.

    camera: pinhole of the window. corner: (top, left) in the whole image. depth_m: along z, NaN without a
    hit. regions: ids of ``Region``, 0 outside the person. whole: regions without occlusion by objects. dark:
    absorbed share of infrared.
    """

    camera: Intrinsics
    corner: tuple[int, int]
    depth_m: Float32
    regions: UInt8
    whole: UInt8
    dark: Float32


def render_view(
    who: Dressed, vertices_m: Float32, around: Mesh, camera_from_world: Pose, whole_image: Intrinsics
) -> PersonView:
    """Render the person's window of an undistorted image.

    vertices_m: float32 (V', 3), draped; world frame as ``around``.
    """
    points = _to_camera(camera_from_world, vertices_m)
    camera, corner = _window(points, whole_image)
    person = rasterize(camera, points, who.faces, closed=True)
    others = rasterize(camera, _to_camera(camera_from_world, around.vertices_m), around.faces)
    layers = _layers(person.depth_m, person.face, others.depth_m, who.face_regions, who.dark)
    return PersonView(camera, corner, *layers)


@numba.njit(cache=True)
def _layers(
    depth: Float32, face: Int32, other: Float32, face_regions: UInt8, face_dark: Float32
) -> tuple[Float32, UInt8, UInt8, Float32]:
    """Return depth, visible regions, unoccluded regions and darkness (h, w).

    depth, face: z-buffer of the person; other: depth of other objects. Darkness: absorbed share of infrared.
    """
    height, width = depth.shape
    nearest, dark = other.copy(), np.zeros((height, width), np.float32)
    regions, whole = np.zeros((height, width), np.uint8), np.zeros((height, width), np.uint8)
    for v in range(height):
        for u in range(width):
            f = face[v, u]
            if f >= 0:
                whole[v, u] = face_regions[f]
                if not other[v, u] < depth[v, u]:
                    nearest[v, u], regions[v, u], dark[v, u] = depth[v, u], face_regions[f], face_dark[f]
    return nearest, regions, whole, dark


def visibility(parts: UInt8, whole: UInt8, n_classes: int) -> Float64:
    """Return the share (n_classes,) of each part's pixels in ``whole`` that are visible in ``parts``.

    [0] is for the whole person. A part without pixels has share 1. n_classes: of the scheme of the parts.
    """
    shown, there = (_tally(image, n_classes).tolist() for image in (parts, whole))
    return np.array([s / t if t else 1.0 for s, t in zip(shown, there, strict=True)])


@numba.njit(cache=True)
def _tally(parts: UInt8, n_classes: int) -> Int64:
    pixels = np.zeros(n_classes, np.int64)
    for row in parts:
        for part in row:
            pixels[part] += 1
    pixels[0] = pixels[1:].sum()
    return pixels


def _to_camera(camera_from_world: Pose, vertices_m: Float32) -> Float32:
    rotation, translation = camera_from_world.rotation, camera_from_world.translation_m
    return _move(vertices_m, rotation.astype(np.float32), translation.astype(np.float32))


@numba.njit(cache=True)
def _move(vertices: Float32, rotation: Float32, translation: Float32) -> Float32:
    moved = np.empty_like(vertices)
    r, t = rotation, translation
    for i in range(len(vertices)):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        moved[i, 0] = r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + t[0]
        moved[i, 1] = r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + t[1]
        moved[i, 2] = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + t[2]
    return moved


def _window(points_m: Float32, whole_image: Intrinsics) -> tuple[Intrinsics, tuple[int, int]]:
    """Return pinhole and corner (top, left) of the window of the image that contains the points (N, 3)."""
    x0, y0, x1, y1 = _slopes(points_m)
    c = whole_image
    left, right = _clip(c.fx * x0 + c.cx, c.fx * x1 + c.cx, c.width)
    top, bottom = _clip(c.fy * y0 + c.cy, c.fy * y1 + c.cy, c.height)
    cx, cy = c.cx - left, c.cy - top
    return replace(c, width=right - left, height=bottom - top, cx=cx, cy=cy), (top, left)


@numba.njit(cache=True)
def _slopes(points: Float32) -> tuple[float, float, float, float]:
    """Return the least x / z and y / z, then the greatest, of the points beyond the near plane."""
    x0, y0, x1, y1 = np.float32(1e6), np.float32(1e6), np.float32(-1e6), np.float32(-1e6)
    for i in range(len(points)):
        if points[i, 2] > NEAR_M:
            x, y = points[i, 0] / points[i, 2], points[i, 1] / points[i, 2]
            x0, y0, x1, y1 = min(x0, x), min(y0, y), max(x1, x), max(y1, y)
    return float(x0), float(y0), float(x1), float(y1)


def _clip(low: float, high: float, size: int) -> tuple[int, int]:
    start = int(min(max(low - BORDER_PX, 0), size - 1))
    return start, int(min(max(high + BORDER_PX + 1, start + 1), size))


def occluder(eye_m: Float64, seen_m: Float64, rng: np.random.Generator) -> Mesh:
    """Return a randomly rotated box, at 50 to 85 % of the way from the camera to a point of the person,
    world.

    Random occluders improve results on occluded and unoccluded people (Sarandi et al. 2018).
    """
    half = np.exp(rng.uniform(np.log(THING_M[0]), np.log(THING_M[1]), 3)) / 2
    mesh = box(tuple(-half), tuple(half), Surface.TABLE)
    rotation = Rotation.random(rng=rng).as_matrix()
    centre = eye_m + rng.uniform(0.5, 0.85) * (seen_m - eye_m)
    return mesh.placed(rotation, centre)


def cut(person: Bool, rng: np.random.Generator) -> Bool:
    """Return a person's mask (h, w) without one to three random ellipses.

    Extraction by temperature leaves such holes (Nishi & Miura 2017, Fig. 12).
    """
    v, u = np.nonzero(person)
    extent = max(np.ptp(v), np.ptp(u)) + 1
    rows, columns = np.ogrid[: person.shape[0], : person.shape[1]]
    left = person.copy()
    for _ in range(int(rng.integers(1, 4))):
        i = int(rng.integers(len(v)))
        long, short = extent * rng.uniform(0.06, 0.22), extent * rng.uniform(0.03, 0.12)
        turn = rng.uniform(0, np.pi)
        y, x = rows - v[i], columns - u[i]
        along = (np.cos(turn) * x + np.sin(turn) * y) / long
        across = (np.cos(turn) * y - np.sin(turn) * x) / short
        left &= along**2 + across**2 > 1
    return left
