"""Guide of a calibration: which view of the hole plate it needs next, and whether there are enough.

Lens and pose of a camera are told apart by plates that are tilted, near and far, and in the image's corners
(Zhang 2000); how sure every number is says the bundle adjustment's covariance.
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

Tilt = Literal["flat", "top", "bottom", "left", "right"]
"""The edge of the plate that is farther away than the others."""
TILTS: tuple[Tilt, ...] = ("flat", "top", "bottom", "left", "right")
TILT_DEG, FLAT_DEG = 25.0, 12.0
"""How far a plate is to be tilted, and up to where it counts as flat. Chosen by eye: from 35 degrees on the
thermal camera's holes get too narrow."""
ENOUGH_VIEWS = 12
"""With fewer, nothing is called good: the covariance of few views is itself not sure. Chosen by eye."""
REACH = 0.62
"""How far from the middle places lie, as a share of what keeps the plate in every image. Chosen by eye."""
WANTED_PLACE, WANTED_TILT, WANTED_DISTANCE = 2, 3, 8
"""Views that are wanted of each place, tilt and distance before any of them twice as often. Chosen by eye."""
NEAR, FAR, HOLE_PX = 1.65, 1.55, 2.1
"""Nearest distance over that at which the plate fills an image, farthest over nearest, and a hole's least
diameter in the coarsest image, pixels. They give the distances of ``rig_templates``. Chosen by eye."""
SAME_DEG, SAME_M = 4.0, 0.03
"""A view that differs by less from an earlier one says nothing new. Chosen by eye."""


class Wish(NamedTuple):
    """A view: place in the depth image (-1, 0, 1 to the right and down), tilt, and whether far."""

    right: int
    down: int
    tilt: Tilt
    far: bool

    @property
    def text(self) -> str:
        """Text for the person who holds the plate; right and left as the cameras see it."""
        rows, columns = ("top", "middle", "bottom"), ("left", "centre", "right")
        place = f"{rows[self.down + 1]} {columns[self.right + 1]}".replace("middle centre", "centre")
        tilt = "facing the cameras" if self.tilt == "flat" else f"its {self.tilt} edge turned away"
        return f"{'far' if self.far else 'near'}, at the {place} of the image, {tilt}"


@dataclass(frozen=True)
class Room:
    """Where a plate can be held: distances in metres, and how far aside, as x / z and y / z."""

    near_m: float
    far_m: float
    aside: float
    below: float

    @staticmethod
    def of(guess: RigCalibration, plate: HolePlate) -> "Room":
        """By the cameras' rough intrinsics: the plate in every image, holes of HOLE_PX or more."""
        cameras = [camera for name in CAMERAS if (camera := getattr(guess, name)) is not None]
        views = np.min([(c.width / 2 / c.fx, c.height / 2 / c.fy) for c in cameras], axis=0)
        half_m = np.diff(plate.size_m, axis=0)[0] / 2
        near_m = NEAR * float((half_m / views).max())
        far_m = min(FAR * near_m, plate.hole_m * min(c.fx for c in cameras) / HOLE_PX)
        far_m = max(far_m, 1.1 * near_m)
        aside, below = REACH * np.maximum(views - half_m / ((near_m + far_m) / 2), 0.05)
        return Room(near_m, far_m, float(aside), float(below))

    def pose(self, wish: Wish, plate: HolePlate) -> Pose:
        """depth_from_plate of a wish."""
        z = self.far_m - 0.1 * (self.far_m - self.near_m) if wish.far else self.near_m
        z += 0.05 * (self.far_m - self.near_m)
        center = np.array([wish.right * self.aside * z, wish.down * self.below * z, z])
        rotation = _turned(wish.tilt)
        return Pose(rotation, center - rotation @ _middle(plate))

    def wish_of_view(self, view: PlateView, plate: HolePlate, guess: RigCalibration) -> Wish:
        """The wish that a view comes nearest to, which the depth camera must have seen."""
        pose = _pose(view, plate, guess)
        x, y, z = pose.apply(_middle(plate))
        right, down = (
            int(np.clip(np.rint(at / z / by), -1, 1)) for at, by in ((x, self.aside), (y, self.below))
        )
        return Wish(right, down, _tilt_of(pose), bool(z > (self.near_m + self.far_m) / 2))


@dataclass(frozen=True)
class Guidance:
    """What the views so far are worth. seen: what each of them is; wanted: the next one, None when done.

    found: the calibration by now, None with too few views; good: whether it can be relied on.
    """

    seen: tuple[Wish, ...]
    wanted: Wish | None
    found: Adjusted | None
    good: bool


def guide(views: Sequence[PlateView], plate: HolePlate, guess: RigCalibration, room: Room) -> Guidance:
    """The next view that is wanted after these, and what they give. Pure: the same views, the same answer."""
    seen = tuple(room.wish_of_view(view, plate, guess) for view in views if "depth" in view.centers_px)
    found = _adjusted(views, plate, guess)
    good = found is not None and len(seen) >= ENOUGH_VIEWS and judge(found)[0]
    return Guidance(seen, None if good else next_wish(seen), found, good)


def next_wish(seen: Sequence[Wish]) -> Wish:
    """The view of which place, tilt and distance have been seen least; a corner first where all are alike."""
    places = Counter((wish.right, wish.down) for wish in seen)
    tilts, far, whole = Counter(wish.tilt for wish in seen), Counter(wish.far for wish in seen), Counter(seen)

    def need(wish: Wish) -> float:
        place = places[wish.right, wish.down] / WANTED_PLACE
        return (
            place + tilts[wish.tilt] / WANTED_TILT + far[wish.far] / WANTED_DISTANCE + whole[wish]
            - 0.01 * (abs(wish.right) + abs(wish.down))
        )  # fmt: skip

    wishes = (Wish(*fields) for fields in product((-1, 0, 1), (-1, 0, 1), TILTS, (False, True)))
    return min(wishes, key=need)


def is_new(view: PlateView, before: Sequence[PlateView], plate: HolePlate, guess: RigCalibration) -> bool:
    """Whether all cameras see the plate, and it is held otherwise than in every view before."""
    wanted = {name for name in CAMERAS if getattr(guess, name) is not None}
    if not wanted <= view.centers_px.keys():
        return False
    pose = _pose(view, plate, guess)
    for other in before:
        known = _pose(other, plate, guess)
        turn = np.degrees(np.arccos(np.clip((np.trace(pose.rotation.T @ known.rotation) - 1) / 2, -1, 1)))
        moved = np.linalg.norm(pose.apply(_middle(plate)) - known.apply(_middle(plate)))
        if turn < SAME_DEG and moved < SAME_M:
            return False
    return True


def _adjusted(views: Sequence[PlateView], plate: HolePlate, guess: RigCalibration) -> Adjusted | None:
    if len(views) < LEAST_VIEWS:
        return None
    try:
        return adjust(list(views), plate, guess)
    except CalibrationError:
        return None  # some camera has seen too few of them


def _pose(view: PlateView, plate: HolePlate, guess: RigCalibration) -> Pose:
    return plate_pose(view.centers_px["depth"], plate, guess.depth)


def _middle(plate: HolePlate) -> NDArray[np.float64]:
    return np.array([*plate.size_m.mean(axis=0), 0.0])


def _tilt_of(pose: Pose) -> Tilt:
    x, y, z = pose.rotation[:, 2]
    bottom_deg, left_deg = np.degrees(np.arctan2((-y, x), abs(z)))
    if max(abs(bottom_deg), abs(left_deg)) < FLAT_DEG:
        return "flat"
    if abs(bottom_deg) > abs(left_deg):
        return "bottom" if bottom_deg > 0 else "top"
    return "left" if left_deg > 0 else "right"


def _turned(tilt: Tilt) -> NDArray[np.float64]:
    """Rotation of a plate whose edge is turned away: about x for top and bottom, about y for the sides."""
    angle = np.radians({"flat": 0.0, "bottom": TILT_DEG, "left": TILT_DEG}.get(tilt, -TILT_DEG))
    c, s = np.cos(angle), np.sin(angle)
    if tilt in ("top", "bottom", "flat"):
        return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
