"""People on an open floor in front of a wall: on their feet, bending, kneeling, slumped at the wall, fallen.

Postures of each kind come from its own generator; joint angles glide from one posture to the next. Constants
are untuned unless a source is given.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from synth.body.body import Body, pose
from synth.body.flesh import flesh_of
from synth.body.skeleton import SIGNS, Posture
from synth.data_files import TRAINING, Cast
from synth.pose.pose_parameters import Moment, Posed
from synth.pose.postures import (
    HEAVE,
    height_to_rest,
    lain,
    poses_of,
    posture_of_moment,
    pulls_of,
    risen,
)  # fmt: skip
from synth.pose.settle import settle
from synth.pose.standing import stood
from synth.pose.standing_parameters import draw_standing
from synth.surface.furniture import FLOOR, Ground, Solid, Surface

# of the kinds of postures: each has enough frames
SHARES = {"standing": 0.4, "upright": 0.3, "slumped": 0.12, "fallen": 0.18}
# standard deviation of the heading, beside -y
FACING_DEG = {"standing": 60.0, "upright": 60.0, "slumped": 12.0, "fallen": 180.0}
ROAM_M = 0.3  # greatest distance of a body's middle from the place's, across and along
GLIDE_S, STAYS = (1.0, 3.0), (2, 5)  # seconds from one posture to the next; postures of one kind in a row
OFF_WALL_M = 0.01  # distance of the rearmost skin, for clothes on a wall


@dataclass(frozen=True)
class OnFloor:
    """Behaviour of a person on the floor in front of a wall: standing, kneeling, slumped at it, or fallen.

    wall_y: y of the wall, world, metres. cast: of the poses. A moment (pose parameters) names two postures by
    kind and seed, and the share of the way from the first to the second.
    """

    wall_y: float
    cast: Cast = TRAINING

    def draw(self, rng: np.random.Generator) -> Moment:
        key = _draw(_kind(rng), rng)
        return _between(key, key, 0.0)

    def stream(self, rng: np.random.Generator, frames_per_second: float) -> Iterator[Moment]:
        """Yield an endless stream of moments: several postures of one kind, then of another."""
        current = _draw(_kind(rng), rng)
        while True:
            kind = _kind(rng)
            for _ in range(int(rng.integers(*STAYS))):
                following = _draw(kind, rng)
                steps = max(1, round(rng.uniform(*GLIDE_S) * frames_per_second))
                yield from (_between(current, following, i / steps) for i in range(steps))
                current = following

    def pose(self, body: Body, moment: Moment) -> Posed:
        """Return a body posed at a moment: vertices float32 (V, 3) and joints (J, 3), world, metres."""
        start = _posture(self, body, moment["kind"], moment["seed"])
        if moment["share"] == 0:
            return pose(body, start)
        end = _posture(self, body, moment["next_kind"], moment["next_seed"])
        way = _on_floor(body, _glided(start, end, moment["share"]), self.wall_y)
        settled = settle(flesh_of(body), way, [FLOOR, _wall(self.wall_y)], [])
        return pose(body, _on_floor(body, settled, self.wall_y))


KINDS = tuple(SHARES)


def _kind(rng: np.random.Generator) -> int:
    return int(rng.choice(len(KINDS), p=list(SHARES.values())))


def _draw(kind: int, rng: np.random.Generator) -> tuple[int, int]:
    return kind, int(rng.integers(2**31))


def _between(start: tuple[int, int], end: tuple[int, int], share: float) -> Moment:
    names = ("kind", "seed", "next_kind", "next_seed")
    return dict(zip(names, (*start, *end), strict=True)) | {"share": share * share * (3 - 2 * share)}


@lru_cache(maxsize=16)
def _posture(place: OnFloor, body: Body, kind: float, seed: float) -> Posture:
    name, rng = KINDS[int(kind)], np.random.default_rng(int(seed))
    poses, wall_y = poses_of(place.cast), place.wall_y
    if name == "standing":
        posture = stood(body, draw_standing(rng, place.cast))
    elif name == "upright":
        posture = risen(body, None, poses.upright.single(rng)[1])
    elif name == "fallen":
        posture = lain(body, Ground(), poses.fallen.single(rng)[1])
    else:
        posture = slumped(body, poses.slumped.single(rng)[1])
    facing, x, y = rng.normal(0, FACING_DEG[name]), *rng.uniform(-ROAM_M, ROAM_M, 2)
    turn = Rotation.from_euler("z", facing, degrees=True)
    turned = Posture(posture.angles_rad.copy(), np.zeros(3))
    turned.angles_rad[0] = (turn * _pelvis(posture)).as_euler("XYZ") * SIGNS[0]
    middle = pose(body, turned)[1].mean(axis=0)
    at = np.array([x, wall_y if name == "slumped" else y, 0.0])
    return _on_floor(body, Posture(turned.angles_rad, at - middle), wall_y)


def slumped(body: Body, moment: Moment) -> Posture:
    """Return the posture of a body that sits on the floor, its back at a wall at y = 0."""
    flesh, posture = flesh_of(body), posture_of_moment(moment)
    trunk, _ = pose(body, posture, flesh.trunk)
    place = np.array([0.0, -OFF_WALL_M - float(trunk[:, 1].max()), height_to_rest(trunk, [FLOOR])])
    return settle(flesh, Posture(posture.angles_rad, place), [FLOOR, _wall(0.0)], pulls_of(moment), HEAVE)


def _wall(y: float) -> Solid:
    return Solid((-10.0, y - OFF_WALL_M, 0.0), (10.0, y + 1.0, 10.0), 0.0, Surface.WALL)


def _pelvis(posture: Posture) -> Rotation:
    return Rotation.from_euler("XYZ", posture.angles_rad[0] * SIGNS[0])


def _glided(start: Posture, end: Posture, share: float) -> Posture:
    angles = (1 - share) * start.angles_rad + share * end.angles_rad
    both = Rotation.concatenate([_pelvis(start), _pelvis(end)])
    angles[0] = Slerp([0.0, 1.0], both)(share).as_euler("XYZ") * SIGNS[0]
    return Posture(angles, (1 - share) * start.pelvis_m + share * end.pelvis_m)


def _on_floor(body: Body, posture: Posture, wall_y: float) -> Posture:
    vertices, _ = pose(body, posture)
    out = min(0.0, wall_y - OFF_WALL_M - float(vertices[:, 1].max()))
    up = height_to_rest(vertices, [FLOOR])
    return Posture(posture.angles_rad, posture.pelvis_m + np.array([0.0, out, up]))
