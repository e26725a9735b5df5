"""A point cloud file (PCD, PLY, LAS, LAZ) as a source of one depth image with the cloud's colours.

An organised cloud is already a depth image: its camera is fitted to its grid. Any other cloud in a camera's
frame stays there and is projected to a camera at its origin. A cloud in another frame is moved into a
camera's view.
"""

import hashlib
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError, Setting
from sensors.importers.clouds.axes import AXES
from sensors.importers.clouds.camera_place import view_of
from sensors.importers.clouds.las import read_las
from sensors.importers.clouds.pcd_file import read_pcd
from sensors.importers.clouds.ply_file import read_ply
from sensors.importers.clouds.projection import fill_from_nearest, pixels_of
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.frame import FARTHEST_MM, FrameSource, RigFrame, mm_from_metres, regular_times_ns
from sensors.rig.rig_calibration import Pose, RigCalibration

READERS = {".pcd": read_pcd, ".ply": read_ply, ".las": read_las, ".laz": read_las}
STRAY = 1e6  # units from the middle beyond which a point is dropped: a kilometre in millimetres; untuned
COARSE_M = 0.005  # step of coordinates above which surfaces have stairs as high as noise; untuned


class CloudFile(FrameSource):
    """A point cloud file as a ``FrameSource`` of one frame.

    cloud: its points as the file has them. notes: missing data; how unit, axes and camera were found. Raises
    FormatError for a damaged file, or points that give no depth image.
    """

    path: Path

    def __init__(self, path: Path, options: ImportOptions = AS_STATED) -> None:
        if options.axes not in ("", *AXES):
            raise FormatError(f"axes {options.axes[:20]!r} are unknown; use {', '.join(AXES)}")
        self.path, self.name = path, path.stem
        self.cloud = READERS[path.suffix.lower()](path)
        points = _finite_points(self.cloud.points())
        if (count := np.isfinite(points[:, 0]).sum()) < 2:
            raise FormatError(f"{path} holds {count} finite points; give the cloud of a depth image")
        self._view = view_of(path, self.cloud, points, options)
        depth_m = np.where(self._view.shown >= 0, self._view.points_m[self._view.shown, 2], np.nan)
        self._depth_mm = mm_from_metres(depth_m)
        if not self._depth_mm.any():
            nearest = float(np.nanmin(np.abs(self._view.points_m[:, 2])))
            raise FormatError(
                f"{path}: no point is within the {FARTHEST_MM / 1000:g} m of a depth image (the nearest is "
                f"{nearest:.4g} m away); give the millimetres of a unit",
                Setting.DEPTH_UNIT,
            )
        colors, camera = self.cloud.colors(), self._view.camera
        self.calibration, self._color = RigCalibration(camera), None
        if colors is not None:
            self.calibration = RigCalibration(camera, camera, Pose.identity())
            self._color = _png(colors, self._view.shown)
        self.times_ns = regular_times_ns(1)
        self.notes = (
            *self._view.how,
            *self._content_notes(),
            "no colour images" if colors is None else "colours of the cloud's points",
            "no thermal images",
            "one frame, without time stamp",
        )

    @property
    def sha256(self) -> str:
        """Return the SHA-256 of the file, in hexadecimal."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def _frame(self, index: int) -> RigFrame:
        return RigFrame(index, int(self.times_ns[index]), self._depth_mm, self._color)

    def _content_notes(self) -> list[str]:
        notes = []
        if (step_m := self.cloud.step() * self._view.scale) > COARSE_M:
            notes.append(
                f"doubtful: this far from the origin its 32-bit coordinates are {step_m:.2g} m apart; "
                "export the cloud with doubles, or without its offset"
            )
        if self.cloud.splats:
            notes.append("Gaussian splats: only their centres are read, without colours")
        if self.cloud.faces:
            notes.append(f"a mesh: of its {self.cloud.faces} faces only the corners are read")
        return notes

    @cached_property
    def pixels(self) -> NDArray[np.intp]:
        """Return the flat index (n,) of the pixel that shows each point of ``cloud``; -1 without such a
        pixel.
        """
        depth_m, view = np.where(self._depth_mm > 0, self._depth_mm / 1000, np.nan), self._view
        if view.organised:
            return np.where(np.isfinite(depth_m.ravel()), np.arange(depth_m.size), -1)
        pixels = pixels_of(view.points_m, view.camera, depth_m)
        return fill_from_nearest(view.points_m, pixels, view.spacing_m) if view.spacing_m else pixels


def _finite_points(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (n, 3) with NaN for useless ones.

    These are at the origin, not finite, or more than ``STRAY`` units from the middle of the cloud.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        points[~np.isfinite(points).all(axis=1) | ~points.any(axis=1)] = np.nan
        there = np.isfinite(points[:, 0])
        if there.any():
            points[(np.abs(points - np.median(points[there], axis=0)) > STRAY).any(axis=1)] = np.nan
    return points


def _png(colors: NDArray[np.uint8], shown: NDArray[np.intp]) -> bytes:
    """Return the colours (n, 3) of the points that pixels show, as a PNG; pixels without a point are
    black.
    """
    image = np.where((shown >= 0)[..., None], colors[shown], 0).astype(np.uint8)
    return bytes(cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))[1].tobytes())
