"""Random rooms about a camera and people: floor, walls, panes and things. Constants are untuned."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from eval.training.rooms.floor_plan import FloorPlan
from eval.training.rooms.panes import draw_pane
from eval.training.rooms.things import draw_thing
from synth.data_files import Cast
from synth.surface.furniture import Surface
from synth.surface.rasterize import Mesh, box, sheet

EMPTY, WALL, CEILING = 0.06, 0.8, 0.25  # shares: no room; each wall; ceilings
BEYOND_M, ROOM_HEIGHT_M = (0.3, 3.0), (2.2, 3.2)  # from camera and people to the walls; height of the room
MOST_THINGS = 16  # in a room
NEAR_PEOPLE, AT_WALL = 0.4, 0.35  # shares of things by place; the rest stand anywhere
PANES = (0.5, 0.3, 0.2)  # shares of rooms with none, one and two
OFF_WALL_M = 0.02  # from a wall to its panes
TRIES = 4  # places drawn for a thing


class Room(NamedTuple):
    """Meshes of a room, world frame, metres.

    shell: floor, walls, pillar and ceiling. panes: see `eval.training.rooms.panes`.
    """

    shell: list[Mesh]
    panes: list[Mesh]
    things: list[Mesh]


def draw_surroundings(
    rng: np.random.Generator, points_m: Float64, plan: FloorPlan, cast: Cast, *, may_be_none: bool
) -> Room:
    """Draw a room around points (n, 3): the camera, then people. Its things stand on free cells of ``plan``.

    may_be_none: allow a room without meshes.
    """
    if rng.random() < EMPTY and may_be_none:
        return Room([], [], [])
    turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
    inside = points_m @ turn  # in the room's frame: turn.T p
    beyond = np.exp(rng.uniform(np.log(BEYOND_M[0]), np.log(BEYOND_M[1]), (2, 2)))
    low, high = inside[:, :2].min(axis=0) - beyond[0], inside[:, :2].max(axis=0) + beyond[1]
    meshes, panes = shell(rng, low, high)
    nobody = np.zeros(3)
    walls, panes = ([mesh.placed(turn, nobody) for mesh in group] for group in (meshes, panes))
    things: list[Mesh] = []
    for _ in range(int(rng.integers(MOST_THINGS + 1))):
        thing = draw_thing(rng, cast)
        for _ in range(TRIES):
            moved = thing.placed(*place(rng, turn, inside, np.array([low, high])))
            if plan.take([moved]):
                things.append(moved)
                break
    return Room(walls, panes, things)


def shell(rng: np.random.Generator, low: Float64, high: Float64) -> tuple[list[Mesh], list[Mesh]]:
    """Return floor, walls, a pillar and a ceiling, and panes, between two corners (2,)."""
    corner, up = np.array([*low, 0.0]), np.array([0.0, 0.0, rng.uniform(*ROOM_HEIGHT_M)])
    along, across = np.array([high[0] - low[0], 0, 0]), np.array([0, high[1] - low[1], 0])
    meshes = [sheet(corner, along, across, Surface.FLOOR)]
    walls = [(corner, along), (corner, across), (corner + across, along), (corner + along, across)]
    meshes += [sheet(at, side, up, Surface.WALL) for at, side in walls if rng.random() < WALL]
    middle, panes = np.array([*(low + high) / 2, 0.0]), []
    for _ in range(int(rng.choice(len(PANES), p=PANES))):
        at, side = walls[int(rng.integers(4))]
        inwards = OFF_WALL_M * np.sign(np.round(middle - at - side / 2, 6))
        panes.append(draw_pane(rng, at + inwards, side))
    if rng.random() < CEILING:
        meshes.append(sheet(corner + up, along, across, Surface.WALL))
    if rng.random() < 0.2:
        x, y = low + rng.uniform(0, 1, 2) * (high - low) * (1, 0)
        meshes.append(box((x - 0.2, y - 0.01, 0), (x + 0.2, y + 0.25, float(up[2])), Surface.WALL))
    return meshes, panes


def place(
    rng: np.random.Generator, turn: Float64, inside: Float64, corners: Float64
) -> tuple[Float64, Float64]:
    """Draw a rotation (3, 3) and a place (3,) for a thing: near people, at a wall, or anywhere."""
    kind, yaw = rng.random(), float(rng.uniform(-np.pi, np.pi))
    at: Float64 = corners[0] + rng.random(2) * (corners[1] - corners[0])
    if kind < NEAR_PEOPLE and len(inside) > 1:
        about = inside[int(rng.integers(1, len(inside))), :2]
        at = about + rng.uniform(0.35, 1.0) * np.array([np.cos(yaw), np.sin(yaw)])
        yaw = float(rng.uniform(-np.pi, np.pi))
    elif kind < NEAR_PEOPLE + AT_WALL:
        axis, end = (int(k) for k in rng.integers(2, size=2))
        inwards = 1 - 2 * end
        at[axis] = corners[end, axis] + inwards * 0.3
        # A thing's front faces -y.
        yaw = (0.0 if axis else -np.pi / 2) + (np.pi if inwards > 0 else 0.0)
    rotation = turn @ Rotation.from_euler("z", yaw).as_matrix()
    return rotation, turn @ np.array([*at, 0.0])
