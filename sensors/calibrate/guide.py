"""Guide of a calibration: the next view of the hole plate, and whether the views suffice.

Tilted plates, near and far and in the image's corners, separate a camera's lens from its pose (Zhang 2000);
the bundle adjustment's covariance gives the accuracy. Constants are untuned unless a source is given.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.calibrate.bundle import LEAST_VIEWS, Adjusted, adjust
from sensors.calibrate.hole_plate import HolePlate
from sensors.calibrate.plate_view import CAMERAS, PlateView, plate_pose
from sensors.calibrate.verdict import judge
from sensors.errors import CalibrationError
from sensors.rig.rig_calibration import Pose, RigCalibration

Tilt = Literal["flat", "top", "bottom", "left", "right"]  # the plate's edge that is turned away
TILTS: tuple[Tilt, ...] = ("flat", "top", "bottom", "left", "right")
TILT_DEG, FLAT_DEG = 25.0, 12.0  # of a tilted plate, and up to which it is flat; 35 narrows thermal holes
ENOUGH_VIEWS = 12  # least views of a good calibration, because few make the covariance unsure
REACH = 0.62  # of places from the middle, as a share of the range that keeps the plate in every image
WANTED_PLACE, WANTED_TILT, WANTED_DISTANCE = 2, 3, 8  # views of each before any is wanted twice as often
NEAR, FAR = 1.65, 1.55  # nearest distance over the one that fills an image; farthest over nearest
HOLE_PX = 2.1  # least diameter of a hole in the coarsest image
SAME_DEG, SAME_M = 4.0, 0.03  # a view that differs by less from an earlier one is not new


class Placement(NamedTuple):
    """Placement of the plate: cell of the depth image (-1, 0, 1 to the right and down), tilt, distance."""

    right: int
    down: int
    tilt: Tilt
    far: bool

    @property
    def text(self) -> str:
        """Return an instruction for the person who holds the plate; right and left are in the image."""
        rows, columns = ("top", "middle", "bottom"), ("left", "centre", "right")
        place = f"{rows[self.down + 1]} {columns[self.right + 1]}".replace("middle centre", "centre")
        tilt = "facing the cameras" if self.tilt == "flat" else f"its {self.tilt} edge turned away"
        return f"{'far' if self.far else 'near'}, at the {place} of the image, {tilt}"


@dataclass(frozen=True)
class PlateSetup:
    """Plate, rough calibration, and the plate's range: distances in metres, and limits of x / z and y / z."""

    plate: HolePlate
    guess: RigCalibration
    near_m: float
    far_m: float
    aside: float
    below: float

    @staticmethod
    def of(guess: RigCalibration, plate: HolePlate) -> "PlateSetup":
        """Return the setup whose range keeps the plate in every image and holes of HOLE_PX or more."""
        cameras = [camera for name in CAMERAS if (camera := getattr(guess, name)) is not None]
        views = np.min([(c.width / 2 / c.fx, c.height / 2 / c.fy) for c in cameras], axis=0)
        half_m = np.diff(plate.size_m, axis=0)[0] / 2
        near_m = NEAR * float((half_m / views).max())
        far_m = min(FAR * near_m, plate.hole_m * min(c.fx for c in cameras) / HOLE_PX)
        far_m = max(far_m, 1.1 * near_m)
        aside, below = REACH * np.maximum(views - half_m / ((near_m + far_m) / 2), 0.05)
        return PlateSetup(plate, guess, near_m, far_m, float(aside), float(below))

    def pose(self, placement: Placement) -> Pose:
        """Return the pose depth_from_plate of a placement."""
        z = self.far_m - 0.1 * (self.far_m - self.near_m) if placement.far else self.near_m
        z += 0.05 * (self.far_m - self.near_m)
        center = np.array([placement.right * self.aside * z, placement.down * self.below * z, z])
        rotation = _turned(placement.tilt)
        return Pose(rotation, center - rotation @ self.middle)

    def pose_of(self, view: PlateView) -> Pose:
        """Return the pose depth_from_plate of a view; the depth camera must have found the plate."""
        return plate_pose(view.centers_px["depth"], self.plate, self.guess.depth)

    def placement_of(self, view: PlateView) -> Placement:
        """Return the placement nearest to a view."""
        pose = self.pose_of(view)
        x, y, z = pose.apply(self.middle)
        right, down = (
            int(np.clip(np.rint(at / z / by), -1, 1)) for at, by in ((x, self.aside), (y, self.below))
        )
        return Placement(right, down, _tilt_of(pose), bool(z > (self.near_m + self.far_m) / 2))

    @property
    def middle(self) -> NDArray[np.float64]:
        """Return the middle (3,) of the plate in its own frame, in metres."""
        return np.array([*self.plate.size_m.mean(axis=0), 0.0])


@dataclass(frozen=True)
class Guidance:
    """State of the views so far.

    seen: placements of the views. wanted: next placement, None when done. found: current calibration, None
    with too few views. good: True if the calibration is reliable.
    """

    seen: tuple[Placement, ...]
    wanted: Placement | None
    found: Adjusted | None
    good: bool


def guide(views: Sequence[PlateView], setup: PlateSetup) -> Guidance:
    """Return the next wanted placement and the calibration of these views. The result depends on the
    arguments only.
    """
    seen = tuple(setup.placement_of(view) for view in views if "depth" in view.centers_px)
    found = _adjusted(views, setup)
    good = found is not None and len(seen) >= ENOUGH_VIEWS and judge(found)[0]
    return Guidance(seen, None if good else next_placement(seen), found, good)


def next_placement(seen: Sequence[Placement]) -> Placement:
    """Return the rarest placement by place, tilt and distance; a corner first among equals."""
    places = Counter((one.right, one.down) for one in seen)
    tilts, far, whole = Counter(one.tilt for one in seen), Counter(one.far for one in seen), Counter(seen)

    def need(one: Placement) -> float:
        place = places[one.right, one.down] / WANTED_PLACE
        return (
            place + tilts[one.tilt] / WANTED_TILT + far[one.far] / WANTED_DISTANCE + whole[one]
            - 0.01 * (abs(one.right) + abs(one.down))
        )  # fmt: skip

    placements = (Placement(*fields) for fields in product((-1, 0, 1), (-1, 0, 1), TILTS, (False, True)))
    return min(placements, key=need)


def is_new(view: PlateView, before: Sequence[PlateView], setup: PlateSetup) -> bool:
    """Return whether all cameras found the plate, and its placement differs from every earlier view."""
    wanted = {name for name in CAMERAS if getattr(setup.guess, name) is not None}
    if not wanted <= view.centers_px.keys():
        return False
    pose = setup.pose_of(view)
    for known in map(setup.pose_of, before):
        turn = np.degrees(np.arccos(np.clip((np.trace(pose.rotation.T @ known.rotation) - 1) / 2, -1, 1)))
        moved = np.linalg.norm(pose.apply(setup.middle) - known.apply(setup.middle))
        if turn < SAME_DEG and moved < SAME_M:
            return False
    return True


def _adjusted(views: Sequence[PlateView], setup: PlateSetup) -> Adjusted | None:
    if len(views) < LEAST_VIEWS:
        return None
    try:
        return adjust(list(views), setup.plate, setup.guess)
    except CalibrationError:
        return None  # too few views of one camera


def _tilt_of(pose: Pose) -> Tilt:
    x, y, z = pose.rotation[:, 2]
    bottom_deg, left_deg = np.degrees(np.arctan2((-y, x), abs(z)))
    if max(abs(bottom_deg), abs(left_deg)) < FLAT_DEG:
        return "flat"
    if abs(bottom_deg) > abs(left_deg):
        return "bottom" if bottom_deg > 0 else "top"
    return "left" if left_deg > 0 else "right"


def _turned(tilt: Tilt) -> NDArray[np.float64]:
    """Return the rotation of a tilted plate: about x for top and bottom, about y for the sides."""
    angle = np.radians({"flat": 0.0, "bottom": TILT_DEG, "left": TILT_DEG}.get(tilt, -TILT_DEG))
    c, s = np.cos(angle), np.sin(angle)
    if tilt in ("top", "bottom", "flat"):
        return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
