"""View of the hole plate in one frame: hole centres in each camera, and depth readings on the plate."""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sensors.calibrate.hole_plate import HolePlate, find_holes
from sensors.rig.camera import Intrinsics, project
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration

Array = NDArray[np.float64]

SAMPLES = 120  # depth readings of one view, at most; untuned
CLEAR = 1.7  # radii of a hole within which readings mix plate and backing; untuned
USUAL_FOCAL = 0.9  # focal length over width of an unknown camera: 58 degrees wide; untuned
CAMERAS = ("depth", "color", "thermal")


@dataclass(frozen=True)
class PlateView:
    """Hole plate in one frame.

    centers_px: by camera, (n, 2) hole centres, only where all were found. depth_px: (k, 2) pixels (u, v) of
    readings on the plate; depth_mm: (k,) these readings.
    """

    index: int
    centers_px: dict[str, Array]
    depth_px: Array
    depth_mm: Array


def view_plate(frame: RigFrame, plate: HolePlate, depth_camera: Intrinsics) -> PlateView:
    """Find the plate in all images of a frame; for the depth camera, in its infrared image.

    depth_camera: rough intrinsics, which only select the readings on the plate.
    """
    color = frame.decode_color()
    images = {
        "depth": frame.infrared,
        "color": None if color is None else cv2.cvtColor(color, cv2.COLOR_RGB2GRAY),
        "thermal": frame.thermal_c,
    }
    found = {name: find_holes(image, plate) for name, image in images.items() if image is not None}
    centers = {name: px for name, px in found.items() if px is not None}
    if "depth" not in centers:
        return PlateView(frame.index, centers, np.empty((0, 2)), np.empty(0))
    pose = plate_pose(centers["depth"], plate, depth_camera)
    return PlateView(frame.index, centers, *_readings(frame.depth_mm, pose, plate, depth_camera))


def with_all_cameras(guess: RigCalibration, frame: RigFrame) -> RigCalibration:
    """Return a calibration completed with typical lenses for cameras that only the frame has images of.

    Raises FormatError for a broken colour image.
    """
    color = frame.decode_color() if guess.color is None else None
    images: dict[str, NDArray[Any] | None] = {"color": color, "thermal": frame.thermal_c}
    known: dict[str, Any] = {}
    for name, image in images.items():
        if image is not None and getattr(guess, name) is None:
            height, width = image.shape[:2]
            focal, centre = USUAL_FOCAL * width, ((width - 1) / 2, (height - 1) / 2)
            known[name] = Intrinsics(width, height, focal, focal, *centre)
            known[f"{name}_from_depth"] = Pose.identity()
    return replace(guess, **known) if known else guess


def plate_pose(centers_px: Array, plate: HolePlate, camera: Intrinsics) -> Pose:
    """Return the pose camera_from_plate from one image's hole centres (n, 2) (OpenCV's iterative PnP)."""
    board = np.c_[plate.centers_m, np.zeros(len(centers_px))]
    _, turn, shift = cv2.solvePnP(board, centers_px, camera.matrix, np.array(camera.distortion))
    return Pose(Rotation.from_rotvec(turn.ravel()).as_matrix(), np.asarray(shift, np.float64).ravel())


def _readings(
    depth_mm: NDArray[np.uint16], depth_from_plate: Pose, plate: HolePlate, camera: Intrinsics
) -> tuple[Array, Array]:
    """Return readings on the plate between the holes: pixels (k, 2), millimetres (k,)."""
    low, high = plate.size_m
    grid = np.stack(np.meshgrid(*np.linspace(low + 0.01, high - 0.01, 40).T), axis=-1).reshape(-1, 2)
    gaps = np.linalg.norm(grid[:, None] - plate.centers_m[None], axis=2).min(axis=1)
    grid = grid[gaps > CLEAR * plate.hole_m / 2]
    grid = grid[:: max(1, len(grid) // SAMPLES)]
    px = np.rint(project(camera, depth_from_plate.apply(np.c_[grid, np.zeros(len(grid))])))
    height, width = depth_mm.shape
    px = px[((px >= 0) & (px < (width, height))).all(axis=1)]
    mm = depth_mm[px[:, 1].astype(int), px[:, 0].astype(int)].astype(np.float64)
    return px[mm > 0], mm[mm > 0]
