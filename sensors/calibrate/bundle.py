"""One bundle adjustment for a whole rig: intrinsics, poses between cameras and of the plate in every view.

A hole's image is an ellipse whose centre is not the image of the hole's centre; residuals are taken at the
ellipse's centre, from the dual conic (Hartley & Zisserman 2004, section 2.2.3). Depth readings on the plate
determine the axial direction, in which centres are weak. Constants are untuned unless a source is given.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from sensors.calibrate.hole_plate import HolePlate
from sensors.calibrate.plate_view import CAMERAS, PlateView, plate_pose
from sensors.errors import CalibrationError
from sensors.rig.camera import Intrinsics, distort, undistort
from sensors.rig.rig_calibration import Pose, RigCalibration

Array = NDArray[np.float64]

LEAST_VIEWS = 8  # fewer leave nine intrinsics and six pose angles undetermined
LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
LENS_PRIOR = np.array([np.inf, np.inf, np.inf, np.inf, 0.5, 1.0, 0.002, 0.002, 1.0])
"""Standard deviations about zero, because views that miss the image's corners leave the last terms
undetermined. Tangential terms trade against the principal point; iai_kinect2's two Kinects have 0.0002 to
0.002."""
SHIFT_PRIOR_MM = 30.0
"""Millimetres by which a Kinect v2's readings are too far: 13 in iai_kinect2's first unit, 24 in issue 144 of
OpenKinect/libfreenect2. A calibration holds the negative, to be added."""
SIGMA_PX, SIGMA_MM = 0.1, 3.0  # first guesses of the noise, which is then estimated
BAD = 4.0  # multiple of a camera's median root mean square error above which a view is left out
ROBUST = 1.4826  # from the median absolute value to a normal distribution's standard deviation
READINGS = "readings"  # depth readings among the observations, beside the cameras' holes


class Deviations(NamedTuple):
    """Standard deviations of a pose: rotation_deg (3,) about x, y, z; translation_mm (3,) along x, y, z."""

    rotation_deg: Array
    translation_mm: Array


class Residuals(NamedTuple):
    """Residuals of one camera.

    view: (n,) frame index. px: (n, 2) observed places. error_px: (n, 2) observed minus predicted.
    """

    view: NDArray[np.int64]
    px: Array
    error_px: Array

    @property
    def rms_px(self) -> float:
        """Return the root mean square distance between observed and predicted places, in pixels."""
        return float(np.sqrt(np.square(self.error_px).sum(axis=1).mean()))


class Adjusted(NamedTuple):
    """Result of the bundle adjustment.

    deviations: by camera other than depth; residuals: by camera. depth_shift_sd_mm: standard deviation of the
    calibration's depth shift. left_out: frame indices of bad views. views: number of views with the plate.
    """

    calibration: RigCalibration
    deviations: dict[str, Deviations]
    depth_shift_sd_mm: float
    residuals: dict[str, Residuals]
    left_out: tuple[int, ...]
    views: int


def adjust(views: list[PlateView], plate: HolePlate, guess: RigCalibration) -> Adjusted:
    """Compute the intrinsics and poses of all cameras from views of the plate.

    guess: image sizes and the depth camera's rough intrinsics. Raises CalibrationError when too few views
    show the plate to the depth camera, or to another camera together with it.
    """
    views = [view for view in views if "depth" in view.centers_px]
    _check_enough(views, "depth")
    cameras = {name: camera for name in CAMERAS if (camera := getattr(guess, name)) is not None}
    cameras = {n: c for n, c in cameras.items() if n == "depth" or any(n in v.centers_px for v in views)}
    lenses = {name: _lens(name, camera, views, plate) for name, camera in cameras.items()}
    poses = {name: _relative(name, lenses, views, plate) for name in lenses if name != "depth"}
    problem = _Problem.of(views, plate, tuple(lenses))
    plates = [plate_pose(view.centers_px["depth"], plate, lenses["depth"]) for view in views]
    x = problem.solve(_packed(lenses, poses, plates), "soft_l1")
    problem = problem.without_bad(x)
    for name in lenses:
        _check_enough([v for v in views if v.index not in problem.left_out and name in v.centers_px], name)
    x = problem.weighted(x).solve(x, "soft_l1")
    problem = problem.weighted(x)
    return problem.result(problem.solve(x, "linear"), lenses, len(views))


def _check_enough(views: list[PlateView], name: str) -> None:
    if len(views) < LEAST_VIEWS:
        seen = "infrared" if name == "depth" else f"infrared and {name}"
        raise CalibrationError(
            f"{len(views)} frames show the whole plate in {seen}; record at least {LEAST_VIEWS}, better 40"
        )


def _lens(name: str, guess: Intrinsics, views: list[PlateView], plate: HolePlate) -> Intrinsics:
    """Return the initial intrinsics of one camera, calibrated alone (Zhang 2000, in OpenCV)."""
    views = [view for view in views if name in view.centers_px]
    _check_enough(views, name)
    seen = [view.centers_px[name].astype(np.float32) for view in views]
    board = np.c_[plate.centers_m, np.zeros(len(plate.centers_m))].astype(np.float32)
    size = (guess.width, guess.height)
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    _, matrix, lens, *_ = cv2.calibrateCamera([board] * len(seen), seen, size, None, None, flags=flags)
    k1, k2 = lens.ravel()[:2]
    return Intrinsics(*size, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], k1, k2)


def _relative(name: str, lenses: dict[str, Intrinsics], views: list[PlateView], plate: HolePlate) -> Pose:
    """Return the initial pose name_from_depth: of the poses from single views, the one nearest to all
    others.
    """
    poses = [
        plate_pose(view.centers_px[name], plate, lenses[name])
        @ plate_pose(view.centers_px["depth"], plate, lenses["depth"]).inverse()
        for view in views
        if name in view.centers_px
    ]
    probes = np.array([[0, 0, 1.0], [0.3, 0, 1.0], [0, 0.3, 1.0]])
    moved = np.stack([pose.apply(probes) for pose in poses])
    gaps = np.linalg.norm(moved[:, None] - moved[None], axis=-1).sum(axis=(1, 2))
    return poses[int(np.argmin(gaps))]


def _packed(lenses: dict[str, Intrinsics], poses: dict[str, Pose], plates: list[Pose]) -> Array:
    """Return the initial parameters as one vector, in the order of ``_Problem``."""
    numbers = [[getattr(lens, field) for field in LENS] for lens in lenses.values()]
    moves, views = (
        [np.r_[Rotation.from_matrix(p.rotation).as_rotvec(), p.translation_m] for p in group]
        for group in (poses.values(), plates)
    )
    return np.concatenate([*numbers, *moves, [0.0], *views]).astype(np.float64)


class _Seen(NamedTuple):
    """Observations of one kind, one row each: view number, pixels, known values, noise.

    known: (n, 2) plate coordinates of holes in metres, or (n,) readings in millimetres.
    """

    view: NDArray[np.int64]
    px: Array
    known: Array
    sigma: float


@dataclass(frozen=True)
class _Problem:
    """Least-squares problem with unknowns [lenses (9 each), poses (6 each), depth shift, views (6 each)] in
    this order.
    """

    cameras: tuple[str, ...]
    indices: tuple[int, ...]
    radius_m: float
    seen: dict[str, _Seen]
    left_out: tuple[int, ...] = ()

    @staticmethod
    def of(views: list[PlateView], plate: HolePlate, cameras: tuple[str, ...]) -> "_Problem":
        """Return the problem with all observations of the views, and initial guesses of their noise."""
        seen = {}
        for name in cameras:
            rows = [(i, view.centers_px[name]) for i, view in enumerate(views) if name in view.centers_px]
            number = np.repeat([i for i, _ in rows], len(plate.centers_m))
            points = np.tile(plate.centers_m, (len(rows), 1))
            seen[name] = _Seen(number, np.concatenate([px for _, px in rows]), points, SIGMA_PX)
        number = np.repeat(np.arange(len(views)), [len(view.depth_mm) for view in views])
        px, mm = (np.concatenate([getattr(v, part) for v in views]) for part in ("depth_px", "depth_mm"))
        seen[READINGS] = _Seen(number, px, mm, SIGMA_MM)
        return _Problem(cameras, tuple(view.index for view in views), plate.hole_m / 2, seen)

    def solve(self, x: Array, loss: str) -> Array:
        """Return the least-squares solution that starts at ``x``."""
        found = least_squares(
            self.residuals, x, self.jacobian, method="trf", loss=loss, f_scale=2.0, x_scale="jac", max_nfev=40
        )
        return np.asarray(found.x, np.float64)

    def residuals(self, x: Array) -> Array:
        """Return all residuals divided by their standard deviation: centres, depths, then priors."""
        return np.concatenate([*(self._weighed(x, name) for name in self.seen), self._priors(x)])

    def _priors(self, x: Array) -> Array:
        lenses, _, shift_mm, _ = self._unpacked(x)
        priors = [lens[4:] / LENS_PRIOR[4:] for lens in lenses.values()]
        return np.concatenate([*priors, [shift_mm / SHIFT_PRIOR_MM]])

    def _weighed(self, x: Array, name: str) -> Array:
        return np.asarray(self.errors(x, name) / self.seen[name].sigma).ravel()

    def errors(self, x: Array, name: str) -> Array:
        """Return observed minus predicted: centres (n, 2) of one camera in pixels, or readings (n,) in mm."""
        return self._errors_mm(x) if name == READINGS else self._errors_px(x, name)

    def _errors_px(self, x: Array, name: str) -> Array:
        seen, (lenses, poses, _, views) = self.seen[name], self._unpacked(x)
        turn, shift = _moved(views)
        if name != "depth":
            to, by = _moved(poses[name])
            turn, shift = to @ turn, shift @ to.T + by
        center = np.einsum("nij,nj->ni", turn[seen.view][:, :, :2], seen.known) + shift[seen.view]
        # Dual conic a a' + b b' - c c' of the hole with half axes a, b about c: its last column, the centre.
        half = self.radius_m * turn[seen.view][:, :, :2]
        last = (half * half[:, 2:]).sum(axis=2) - center * center[:, 2:]
        ideal = last[:, :2] / last[:, 2:]
        fx, fy, cx, cy = lenses[name][:4]
        return np.asarray(seen.px - distort(_brown(lenses[name]), ideal) * (fx, fy) - (cx, cy), np.float64)

    def _errors_mm(self, x: Array) -> Array:
        """Return depth readings minus the plate's depth along the rays of their pixels, in millimetres."""
        seen, (lenses, _, shift_mm, views) = self.seen[READINGS], self._unpacked(x)
        lens = lenses["depth"]
        ray = undistort(_brown(lens), (seen.px - lens[2:4]) / lens[:2], iterations=15)
        turn, shift = _moved(views)
        normal = turn[seen.view][:, :, 2]
        slope = (normal[:, :2] * ray).sum(axis=1) + normal[:, 2]
        z = (normal * shift[seen.view]).sum(axis=1) / slope
        return np.asarray(seen.known - 1000 * z - shift_mm, np.float64)

    def jacobian(self, x: Array) -> Array:
        """Return the Jacobian by forward differences.

        One step changes the same parameter in the poses of all views, because views do not depend on each
        other.
        """
        base, shared, step = self.residuals(x), 15 * len(self.cameras) - 5, 1e-7
        views = [np.repeat(s.view, s.known.ndim) for s in self.seen.values()]  # a hole has two residuals
        rows, ends = np.concatenate(views), np.cumsum([len(view) for view in views])
        of = {name: slice(e - len(v), e) for name, v, e in zip(self.seen, views, ends, strict=True)}
        inside, priors = np.arange(len(rows)), slice(len(rows), None)
        jacobian = np.zeros((len(base), len(x)))
        for column in range(shared):
            moved = x.copy()
            moved[column] += (h := step * max(1.0, abs(x[column])))
            for name in self._touched(column):
                jacobian[of[name], column] = (self._weighed(moved, name) - base[of[name]]) / h
            jacobian[priors, column] = (self._priors(moved) - base[priors]) / h
        for number in range(6):
            moved = x.copy()
            moved[shared + number :: 6] += step
            change = (self.residuals(moved) - base) / step
            jacobian[inside, shared + 6 * rows + number] = change[inside]
        return jacobian

    def _touched(self, column: int) -> tuple[str, ...]:
        """Return the kinds of observations that depend on a shared unknown."""
        poses, shift = 9 * len(self.cameras), 15 * len(self.cameras) - 6
        if column < 9:
            return "depth", READINGS
        if column == shift:
            return (READINGS,)
        return (self.cameras[column // 9 if column < poses else 1 + (column - poses) // 6],)

    def weighted(self, x: Array) -> "_Problem":
        """Return the same problem with noise estimated from the residuals."""
        sigmas = {name: float(ROBUST * np.median(np.abs(self.errors(x, name)))) for name in self.seen}
        return replace(self, seen={name: s._replace(sigma=sigmas[name]) for name, s in self.seen.items()})

    def without_bad(self, x: Array) -> "_Problem":
        """Return the same problem without views whose errors in any camera are outliers.

        In such views the plate moved between the exposures, or other objects were detected as holes.
        """
        bad = np.zeros(len(self.indices), bool)
        for name in self.cameras:
            view = self.seen[name].view
            square = np.square(self.errors(x, name)).sum(axis=1)
            count = np.bincount(view, minlength=len(bad))
            rms = np.sqrt(np.bincount(view, square, len(bad)) / np.maximum(count, 1))
            bad |= rms > BAD * np.median(rms[count > 0])
        seen = {}
        for name, (view, px, known, sigma) in self.seen.items():
            kept = ~bad[view]
            seen[name] = _Seen(view[kept], px[kept], known[kept], sigma)
        return replace(self, seen=seen, left_out=tuple(np.array(self.indices)[bad].tolist()))

    def result(self, x: Array, guess: dict[str, Intrinsics], views: int) -> Adjusted:
        """Return the calibration of a solution, with its standard deviations."""
        lenses, poses, shift_mm, _ = self._unpacked(x)
        _, pose_sd, shift_sd_mm, _ = self._unpacked(self._deviations(x))
        cameras: dict[str, Any] = {
            name: Intrinsics(guess[name].width, guess[name].height, *map(float, lens))
            for name, lens in lenses.items()
        }
        cameras |= {f"{name}_from_depth": Pose(*_moved(pose)) for name, pose in poses.items()}
        deviations = {n: Deviations(np.degrees(sd[:3]), 1000 * sd[3:]) for n, sd in pose_sd.items()}
        residuals = {
            name: Residuals(np.array(self.indices)[seen.view], seen.px, self.errors(x, name))
            for name, seen in self.seen.items()
            if name != READINGS
        }
        rig = RigCalibration(**cameras, depth_shift_mm=-shift_mm)
        return Adjusted(rig, deviations, shift_sd_mm, residuals, self.left_out, views)

    def _deviations(self, x: Array) -> Array:
        jacobian, residuals = self.jacobian(x), self.residuals(x)
        variance = np.square(residuals).sum() / (len(residuals) - len(x))
        return np.asarray(np.sqrt(variance * np.diag(np.linalg.pinv(jacobian.T @ jacobian, hermitian=True))))

    def _unpacked(self, x: Array) -> tuple[dict[str, Array], dict[str, Array], float, Array]:
        """Return lenses (9,) and poses (6,) by camera, depth shift in millimetres, and views (n, 6)."""
        count = len(self.cameras)
        lenses, poses, shift, views = np.split(x, np.cumsum([9 * count, 6 * (count - 1), 1]))
        by_lens = dict(zip(self.cameras, lenses.reshape(-1, 9), strict=True))
        by_pose = dict(zip(self.cameras[1:], poses.reshape(-1, 6), strict=True))
        return by_lens, by_pose, float(shift[0]), views.reshape(-1, 6)


def _moved(numbers: Array) -> tuple[Array, Array]:
    """Return rotations (..., 3, 3) and translations (..., 3) of pose vectors (..., 6), rotation vector
    first.
    """
    return Rotation.from_rotvec(numbers[..., :3]).as_matrix(), numbers[..., 3:]


def _brown(lens: Array) -> Intrinsics:
    """Return a camera with this distortion, to apply it to rays; size and focal length are unused."""
    return Intrinsics(1, 1, 1.0, 1.0, 0.0, 0.0, *map(float, lens[4:]))
