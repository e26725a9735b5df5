"""Virtual calibration: a ``FrameSource`` of views of the hole plate, with true poses.

Constants are untuned unless a source is given.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from annotate.array_types import Bool, Float32, Float64
from sensors.calibrate.hole_plate import HolePlate
from sensors.files.atomic import check_free, replacing
from sensors.recording.rig_templates import RigTemplate
from sensors.rig.camera import Intrinsics, distort, project, rays
from sensors.rig.frame import FrameSource, RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration, save_calibration
from sensors.session.writer import RepeatableWriter
from synth.appearance.color_camera import encode

BACKING_M = 0.03  # from the plate to the warm backing
TILT_DEG, ROLL_DEG = 35.0, 25.0  # greatest turns out of and in the plate's plane
ASIDE = (5.0, 5.0, 1.0)  # a ray to the wall
PLATE_C, BACKING_C, ROOM_C = 22.0, 30.0, 21.0  # contrast of a heated foam sheet
NETD_C = 0.08  # of the Optris PI200 (data sheet)
BLUR_PX = 0.6  # of a lens, standard deviation
DEPTH_SIGMA = 0.75  # depth noise at 1 m over 2 m: 1.5 mm of a Kinect v2 (Fankhauser et al. 2015)
GREY_SIGMA = 3.0  # noise of the colour camera, of 255
SLIP_M, SLIP_DEG = 0.006, 1.0  # motion of the plate between the exposures of a bad view
SUBPIXELS = 8  # rays a pixel's side at edges
FRAMES_PER_SECOND = 0.5
DEPTH_SHIFT_MM = -8.0  # error of the unit, which its calibration corrects
_KERNEL = np.ones((3, 3), np.uint8)


class _Values(NamedTuple):
    """Grey values, counts or temperatures of plate, backing and room in one camera's image."""

    plate: float
    backing: float
    room: float


class PlateViews(FrameSource):
    """``count`` frames of a rig that views the plate, deterministic in the seed.

    In bad frames the plate moves between the exposures of the cameras.
    """

    def __init__(self, rig: RigTemplate, count: int, seed: int, bad_share: float = 0.1) -> None:
        self.rig, self.calibration = rig, rig.calibration
        self.count, self.seed, self.bad_share = count, seed, bad_share
        self.name = f"virtual-plate-{seed}"
        self.times_ns = np.rint(np.arange(count) / FRAMES_PER_SECOND * 1e9).astype(np.int64)
        slipping = np.random.default_rng((seed, 1)).permutation(count)[: round(bad_share * count)]
        self._bad = frozenset(slipping.tolist())
        self._views = {n: _PlateCamera(camera, rig.plate) for n, camera in _cameras(rig.calibration).items()}

    def _frame(self, index: int) -> RigFrame:
        rng = np.random.default_rng((self.seed, 2, index))
        return self._shoot(index, self._pose(rng), index in self._bad, rng)

    def held(self, index: int, depth_from_plate: Pose) -> RigFrame:
        """Return a view of the plate at a pose; in a share ``bad_share`` of views the plate moves between
        exposures.
        """
        rng = np.random.default_rng((self.seed, 3, index))
        return self._shoot(index, depth_from_plate, bool(rng.random() < self.bad_share), rng)

    def _pose(self, rng: np.random.Generator) -> Pose:
        """Draw depth_from_plate: near the middle of the view, tilted, at arm's length."""
        spin = Rotation.from_euler("z", rng.uniform(-ROLL_DEG, ROLL_DEG), degrees=True)
        tilt = Rotation.from_euler("xy", rng.uniform(-TILT_DEG, TILT_DEG, 2), degrees=True)
        z = rng.uniform(*self.rig.plate_m)
        center = np.array([rng.uniform(-0.28, 0.28) * z, rng.uniform(-0.18, 0.18) * z, z])
        rotation = (tilt * spin).as_matrix()
        middle = np.array([*self.rig.plate.size_m.mean(axis=0), 0.0])
        return Pose(rotation, center - rotation @ middle)

    def _shoot(self, index: int, depth_from_plate: Pose, bad: bool, rng: np.random.Generator) -> RigFrame:
        def slipped() -> Pose:
            if not bad:
                return depth_from_plate
            turn = Rotation.from_rotvec(rng.normal(0, SLIP_DEG, 3), degrees=True).as_matrix()
            return depth_from_plate @ Pose(turn, rng.normal(0, SLIP_M, 3))

        infrared = self._views["depth"].image(depth_from_plate, _Values(9000, 1500, 4000))
        infrared += rng.normal(0, 80, infrared.shape)
        depth = 1000 * self._views["depth"].depth_m(depth_from_plate) + DEPTH_SHIFT_MM
        depth += rng.normal(0, DEPTH_SIGMA * self.rig.depth_sd_mm, depth.shape)
        color = self._color(_pose_of(self.calibration, "color") @ slipped(), rng)
        thermal = self._thermal(_pose_of(self.calibration, "thermal") @ slipped(), rng)
        stamp_ns = round(index * 1e9 / FRAMES_PER_SECOND)
        return RigFrame(index, stamp_ns, _counts(depth), color, thermal, _counts(infrared))

    def _color(self, color_from_plate: Pose, rng: np.random.Generator) -> bytes:
        grey = self._views["color"].image(color_from_plate, _Values(205, 40, 120))
        grey = cv2.GaussianBlur(grey, (0, 0), BLUR_PX) + rng.normal(0, GREY_SIGMA, grey.shape)
        image = np.repeat(np.clip(np.rint(grey), 0, 255).astype(np.uint8)[..., None], 3, axis=2)
        return encode(image)

    def _thermal(self, thermal_from_plate: Pose, rng: np.random.Generator) -> Float32:
        image = self._views["thermal"].image(thermal_from_plate, _Values(PLATE_C, BACKING_C, ROOM_C))
        image = cv2.GaussianBlur(image, (0, 0), BLUR_PX) + rng.normal(0, NETD_C, image.shape)
        return image.astype(np.float32)


def record_plate(
    views: PlateViews, out: Path, progress: Callable[[int], None], *, overwrite: bool = False
) -> Path:
    """Record the views with a rough calibration; return the path of the true calibration.

    Raises ExistsError if a file exists and ``overwrite`` is False.
    """
    truth = out.with_suffix(".calibration.json")
    check_free(truth, overwrite)
    rough = roughly(views.calibration)
    with (
        replacing(truth, overwrite) as temporary,
        RepeatableWriter(out, rough, views.name, overwrite=overwrite) as writer,
    ):
        save_calibration(temporary, replace(views.calibration, depth_shift_mm=-DEPTH_SHIFT_MM))
        for frame in views:
            writer.write(frame)
            progress(1)
    return truth


def roughly(true: RigCalibration) -> RigCalibration:
    """Return a calibration as from a data sheet: rounded focal lengths, central principal point, no
    distortion.
    """
    cameras = {
        name: Intrinsics(c.width, c.height, round(c.fx), round(c.fy), c.width / 2, c.height / 2)
        for name, c in _cameras(true).items()
    }
    poses = {f"{name}_from_depth": Pose.identity() for name in ("color", "thermal")}
    return RigCalibration(**cameras, **poses)  # type: ignore[arg-type]


def _cameras(calibration: RigCalibration) -> dict[str, Intrinsics]:
    return {name: getattr(calibration, name) for name in ("depth", "color", "thermal")}


def _pose_of(calibration: RigCalibration, name: str) -> Pose:
    pose: Pose = getattr(calibration, f"{name}_from_depth")
    return pose


def _counts(image: Float64) -> NDArray[np.uint16]:
    return np.clip(np.rint(image), 0, 65535).astype(np.uint16)


class _PlateCamera:
    """Renderer of the plate for one camera."""

    def __init__(self, camera: Intrinsics, plate: HolePlate) -> None:
        self.camera, self.plate = camera, plate
        self.rays = _seeing(camera)

    def image(self, camera_from_plate: Pose, values: _Values) -> Float64:
        """Return the image (h, w); pixels at edges are means over SUBPIXELS x SUBPIXELS rays."""
        image = np.full(self.camera.shape, float(values.room))
        window = self._window(camera_from_plate)
        rays = self.rays[window]
        seen = self._seen(rays, camera_from_plate, values)
        mixed = cv2.dilate(seen, _KERNEL) != cv2.erode(seen, _KERNEL)
        right, down = np.gradient(rays, axis=1)[mixed], np.gradient(rays, axis=0)[mixed]
        step = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
        fine = [rays[mixed] + du * right + dv * down for dv in step for du in step]
        seen[mixed] = self._seen(np.stack(fine), camera_from_plate, values).mean(axis=0)
        image[window] = seen
        return image

    def depth_m(self, camera_from_plate: Pose) -> Float64:
        """Return the depth (h, w) along z of plate, backing and a wall at 2.5 m."""
        xy, z = _meet(self.rays, camera_from_plate)
        inside, hole = _inside(xy, self.plate)
        return np.where(inside, np.where(hole, z + BACKING_M, z), 2.5)

    def _seen(self, ray: Float64, pose: Pose, values: _Values) -> Float64:
        inside, hole = _inside(_meet(ray, pose)[0], self.plate)
        seen = np.where(inside, np.where(hole, values.backing, values.plate), values.room)
        return seen.astype(np.float64)

    def _window(self, pose: Pose) -> tuple[slice, slice]:
        low, high = self.plate.size_m
        corners = np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])])
        points = pose.apply(corners)
        xy = distort(self.camera, points[:, :2] / points[:, 2:])
        pixels = xy * (self.camera.fx, self.camera.fy) + (self.camera.cx, self.camera.cy)
        height, width = self.camera.shape
        left, top = np.clip(pixels.min(axis=0) - 8, 0, (width, height)).astype(int).tolist()
        right, bottom = np.clip(pixels.max(axis=0) + 9, 0, (width, height)).astype(int).tolist()
        return slice(top, max(bottom, top + 2)), slice(left, max(right, left + 2))


def _seeing(camera: Intrinsics) -> Float64:
    """Return the viewing rays (h, w, 3) of the pixels; ``ASIDE`` where the lens model has no inverse."""
    ray = rays(camera)
    with np.errstate(over="ignore", invalid="ignore"):
        px, (height, width) = project(camera, ray), camera.shape
        off_u, off_v = np.abs(px[..., 0] - np.arange(width)), np.abs(px[..., 1] - np.arange(height)[:, None])
        ray[~((off_u < 0.5) & (off_v < 0.5))] = ASIDE
    return ray


def _meet(ray: Float64, pose: Pose) -> tuple[Float64, Float64]:
    """Return the points where rays (..., 3) meet the plate: plate coordinates (..., 2) and depths (...,),
    metres.
    """
    normal = pose.rotation[:, 2]
    z = (normal @ pose.translation_m) / (ray @ normal)
    local = (ray * z[..., None] - pose.translation_m) @ pose.rotation
    return local[..., :2], z


def _inside(xy: Float64, plate: HolePlate) -> tuple[Bool, Bool]:
    (left, top), (right, bottom) = plate.size_m
    x, y = np.moveaxis(xy, -1, 0)
    row = np.clip(np.rint(y / plate.pitch_m), 0, plate.rows - 1)
    odd = row % 2
    column = np.clip(np.rint((x / plate.pitch_m - odd) / 2), 0, plate.columns - 1)
    aside, below = x - (2 * column + odd) * plate.pitch_m, y - row * plate.pitch_m
    hole = np.square(aside) + np.square(below) < (plate.hole_m / 2) ** 2
    inside = (x > left) & (x < right) & (y > top) & (y < bottom)
    return np.asarray(inside), np.asarray(hole)
