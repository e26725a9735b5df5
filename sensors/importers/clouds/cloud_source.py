"""A point cloud file (PCD, PLY, LAS, LAZ) as a source of one depth image with the cloud's colours.

An organised cloud already is a depth image: its camera is fitted to its grid. Any other cloud that lies in a
camera's frame stays there, and is seen by a camera at its origin; the rest is moved into a camera's view.
"""

import hashlib
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.importers.clouds.axes import AXES
from sensors.importers.clouds.camera_place import view_of
from sensors.importers.clouds.las import read_las
from sensors.importers.clouds.pcd_file import read_pcd
from sensors.importers.clouds.ply_file import read_ply
from sensors.importers.clouds.projection import beside, pixels_of
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.frame import FARTHEST_MM, FrameSource, RigFrame, mm_from_metres, regular_times_ns
from sensors.rig.rig_calibration import Pose, RigCalibration

Float64 = NDArray[np.float64]

READERS = {".pcd": read_pcd, ".ply": read_ply, ".las": read_las, ".laz": read_las}
"""Readers of cloud files by suffix."""
STRAY = 1e6
"""Units from the middle of a cloud from which on a point is dropped: a kilometre in millimetres. Untuned."""
COARSE_M = 0.005
"""Step of coordinates, in metres, above which a surface has stairs as high as a sensor's noise. Untuned."""


class CloudFile(FrameSource):
    """A point cloud file as a ``FrameSource`` of one frame.

    cloud: its points as the file has them. notes: what is absent, how unit, axes and camera were found.
    Raises FormatError.
    """

    def __init__(self, path: Path, options: ImportOptions = AS_STATED) -> None:
        if options.axes not in ("", *AXES):
            raise FormatError(f"axes {options.axes[:20]!r} are unknown; use {', '.join(AXES)}")
        self.path, self.name = path, path.stem
        self.cloud = READERS[path.suffix.lower()](path)
        points = self.cloud.points()
        with np.errstate(invalid="ignore"):
            points[~np.isfinite(points).all(axis=1) | ~points.any(axis=1)] = np.nan
        _drop_strays(points)
        if np.isfinite(points[:, 0]).sum() < 2:
            raise FormatError(f"{path} holds {np.isfinite(points[:, 0]).sum()} finite points; give a surface")
        self._view = view_of(path, self.cloud, points, options)
        depth_m = np.where(self._view.shown >= 0, self._view.points_m[self._view.shown, 2], np.nan)
        self._depth_mm = mm_from_metres(depth_m)
        self._check_depth()
        colors, camera = self.cloud.colors(), self._view.camera
        self.calibration, self._color = RigCalibration(camera), None
        if colors is not None:
            self.calibration = RigCalibration(camera, camera, Pose.identity())
            self._color = _png(colors, self._view.shown)
        self.times_ns = regular_times_ns(1)
        faces = self.cloud.faces
        self.notes = (
            *self._view.how,
            *self._coarse(),
            *(["Gaussian splats: only their centres are read, without colours"] if self.cloud.splats else ()),
            *([f"a mesh: of its {faces} faces only the corners are read"] if faces else ()),
            "no colour images" if colors is None else "colours of the cloud's points",
            "no thermal images",
            "one frame, without time stamp",
        )

    @property
    def sha256(self) -> str:
        """SHA-256 of the file, in hexadecimal."""
        assert self.path is not None
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def _frame(self, index: int) -> RigFrame:
        return RigFrame(index, int(self.times_ns[index]), self._depth_mm, self._color)

    def _coarse(self) -> tuple[str, ...]:
        """Return a note where the numbers of the file are too coarse for a surface."""
        step_m = self.cloud.step() * self._view.scale
        if step_m <= COARSE_M:
            return ()
        return (
            f"doubtful: this far from the origin its 32-bit coordinates are {step_m:.2g} m apart; "
            "export the cloud with doubles, or without its offset",
        )

    def _check_depth(self) -> None:
        """Raise FormatError where the points lie beyond what a depth image holds."""
        if self._depth_mm.any():
            return
        nearest = float(np.nanmin(np.abs(self._view.points_m[:, 2])))
        raise FormatError(
            f"{self.path}: no point is within the {FARTHEST_MM / 1000:g} m of a depth image (the nearest is "
            f"{nearest:.4g} m away); import it with --depth-unit, the millimetres of a unit"
        )

    @cached_property
    def pixels(self) -> NDArray[np.intp]:
        """The flat index (n,) of the pixel that shows each point of ``cloud``; -1 where none does."""
        depth_m = np.where(self._depth_mm > 0, self._depth_mm / 1000, np.nan)
        if self._view.organised:
            return np.where(np.isfinite(depth_m.ravel()), np.arange(depth_m.size), -1)
        pixels = pixels_of(self._view.points_m, self._view.camera, depth_m)
        return beside(self._view.points_m, pixels, self._view.spacing_m) if self._view.spacing_m else pixels


def _drop_strays(points: Float64) -> None:
    """Make points NaN that lie STRAY units from the middle of the cloud: no scene has them in any unit."""
    there = np.isfinite(points[:, 0])
    if there.any():
        with np.errstate(invalid="ignore", over="ignore"):
            points[(np.abs(points - np.median(points[there], axis=0)) > STRAY).any(axis=1)] = np.nan


def _png(colors: NDArray[np.uint8], shown: NDArray[np.intp]) -> bytes:
    """Return the colours (n, 3) of the pixels' points as a PNG; black where there is none."""
    image = np.where((shown >= 0)[..., None], colors[shown], 0).astype(np.uint8)
    return bytes(cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))[1].tobytes())
