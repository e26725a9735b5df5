"""One person among furniture before a depth camera: which part is where, how far, and what hides it."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annotate.parts import BACKGROUND, N_CLASSES, PART_ID
from annotate.registration import KINECT2_DEPTH
from sensors.calibration import Pose
from sensors.camera import Intrinsics
from synth.body import Body
from synth.render import Mesh, rasterize
from synth.skeleton import JOINT_ID, Float64

CAMERA = KINECT2_DEPTH.undistorted()
BORDER_PX = 4
"""Kept around the person, so that edges and slopes there have neighbours."""


@dataclass(frozen=True)
class View:
    """The window of the depth image that holds the person, before any noise.

    camera: pinhole of the window. corner: (top, left) of the window in the whole image. depth_m: float32
    (h, w) along z, NaN where nothing is hit, furniture included. parts: uint8 (h, w) part ids, 0 where
    the person is not. dark: bool (h, w), hair. visible: float64 (12,) share of each part's pixels that
    nothing else hides, 1 where the part shows none; [0] is the whole person's.
    """

    camera: Intrinsics
    corner: tuple[int, int]
    depth_m: NDArray[np.float32]
    parts: NDArray[np.uint8]
    dark: NDArray[np.bool_]
    visible: Float64


def render_view(
    body: Body, hair: NDArray[np.bool_], vertices_m: NDArray[np.float32], around: Mesh, camera_from_world: Pose
) -> View:
    """See a posed body and the closed furniture around it with the Kinect's pinhole; meshes in the world frame.

    hair: bool (F,) as ``hair_faces`` gives it. Only the person's window of the 512 x 424 image is rendered.
    """
    points = _to_camera(camera_from_world, vertices_m)
    camera, corner = _window(points)
    person = rasterize(camera, points, body.faces, closed=True)
    others = rasterize(camera, _to_camera(camera_from_world, around.vertices_m), around.faces, closed=True)
    # Index -1, nothing hit, reads the entry appended last.
    whole = np.append(body.face_parts, np.uint8(BACKGROUND))[person.face]
    hidden = others.depth_m < person.depth_m
    parts = np.where(hidden, np.uint8(BACKGROUND), whole)
    dark = np.append(hair, False)[person.face] & ~hidden
    return View(camera, corner, np.fmin(person.depth_m, others.depth_m), parts, dark, visibility(parts, whole))


def visibility(parts: NDArray[np.uint8], whole: NDArray[np.uint8]) -> Float64:
    """Share (12,) of each part's pixels in ``whole`` that ``parts`` still has; 1 for a part without any.

    Entry 0 is over all parts together.
    """
    shown, all_of_it = (np.bincount(image.ravel(), minlength=N_CLASSES)[:N_CLASSES] for image in (parts, whole))
    shown[0], all_of_it[0] = shown[1:].sum(), all_of_it[1:].sum()
    return np.where(all_of_it > 0, shown / np.maximum(all_of_it, 1), 1.0)


def hair_faces(body: Body) -> NDArray[np.bool_]:
    """Faces (F,) where hair grows: the head above the brow, and its back down to the neck."""
    _, y, z = body.vertices_m[body.faces].mean(axis=1).T
    head = body.joints_m[JOINT_ID["head"]]
    top = body.vertices_m[:, 2].max()
    above = z > head[2] + 0.6 * (top - head[2])
    behind = (y > head[1] + 0.02) & (z > head[2])
    return (body.face_parts == PART_ID["head"]) & (above | behind)


def _to_camera(camera_from_world: Pose, vertices_m: NDArray[np.float32]) -> NDArray[np.float32]:
    rotation, translation = (
        np.asarray(a, np.float32) for a in (camera_from_world.rotation, camera_from_world.translation_m)
    )
    return vertices_m @ rotation.T + translation


def _window(points_m: NDArray[np.float32]) -> tuple[Intrinsics, tuple[int, int]]:
    """The part of the image that the points cover, with a border: its camera and its corner (top, left)."""
    ahead = points_m[points_m[:, 2] > 0.05]
    if len(ahead) == 0:
        return replace(CAMERA, width=1, height=1), (0, 0)
    x, y = ahead[:, 0] / ahead[:, 2], ahead[:, 1] / ahead[:, 2]
    left, right = (int(CAMERA.fx * float(v) + CAMERA.cx) for v in (x.min(), x.max()))
    top, bottom = (int(CAMERA.fy * float(v) + CAMERA.cy) for v in (y.min(), y.max()))
    left, top = (min(max(v - BORDER_PX, 0), size - 1) for v, size in ((left, CAMERA.width), (top, CAMERA.height)))
    width = max(1, min(right + BORDER_PX + 1, CAMERA.width) - left)
    height = max(1, min(bottom + BORDER_PX + 1, CAMERA.height) - top)
    window = replace(CAMERA, width=width, height=height, cx=CAMERA.cx - left, cy=CAMERA.cy - top)
    return window, (top, left)
