"""People gathered in front of a camera: apart, beside and behind each other, cut by the image's borders.

The camera stands over the world's origin and looks along y. Constants are untuned.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from eval.training.rooms.floor_plan import FloorPlan
from eval.training.rooms.people import Figures, draw_figures
from sensors.rig.rig_calibration import Pose
from synth.clothes.dressed import Dressed
from synth.data_files import Cast
from synth.surface.furniture import Surface
from synth.surface.rasterize import Mesh, box, look_at

BESIDE, BEHIND = 0.4, 0.6  # cumulative shares of further people beside and behind another; rest: anywhere
DISTANCE_M = (0.7, 6.0)  # from the camera
FACE_CAMERA = 0.6  # share of people who face the camera roughly
IN_VIEW = 1.1  # greatest azimuth of a person, share of half the field of view
STEP_M, STEPS = 0.06, 15  # by which people move apart until they do not overlap
PLACES = 6  # drawn for a person
IN_FRONT = 0.15  # share of people behind a counter
DOWN_DEG, ROLL_DEG = (-8.0, 30.0), 15.0  # pitch of the camera, and greatest roll


def gather(
    rng: np.random.Generator, people: Sequence[Dressed], plan: FloorPlan, half_view_rad: float, cast: Cast
) -> list[Figures]:
    """Return people in random postures at free places of ``plan``, without those who find no place."""
    placed: list[Figures] = []
    waiting = list(people)
    while waiting:
        figures = draw_figures(waiting, sum(len(one.people) for one in placed), cast, rng)
        waiting = waiting[len(figures.people) :]
        moved = _at_a_free_place(rng, figures, placed, plan, half_view_rad)
        if moved is not None:
            counter = _counter(rng, moved) if rng.random() < IN_FRONT else None
            if counter is not None and plan.take([counter]):
                moved.things.append(counter)
            placed.append(moved)
    return placed


def _at_a_free_place(
    rng: np.random.Generator, figures: Figures, placed: list[Figures], plan: FloorPlan, half_view_rad: float
) -> Figures | None:
    others = [middle(mesh) for one in placed for mesh in one.people]
    for at, step in _places(rng, others, half_view_rad):
        turn = facing(rng, at)
        for i in range(STEPS):
            moved = figures.placed(turn, at + i * step)
            if plan.take([*moved.people, *moved.things]):
                return moved
    return None


def middle(mesh: Mesh) -> Float64:
    """Return the mean vertex (3,)."""
    return np.asarray(mesh.vertices_m.mean(axis=0, dtype=np.float64), np.float64)


def _places(
    rng: np.random.Generator, others: list[Float64], half_view_rad: float
) -> Iterator[tuple[Float64, Float64]]:
    """Yield places (3,) on the floor, and steps (3,) away from the neighbour or the person in front."""
    for _ in range(PLACES):
        kind = rng.random() if others else 1.0
        away, azimuth = np.exp(rng.uniform(*np.log(DISTANCE_M))), rng.uniform(-1, 1) * IN_VIEW * half_view_rad
        along = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
        if kind >= BEHIND:
            yield along * away, STEP_M * along
            continue
        other = others[int(rng.integers(len(others)))] * (1, 1, 0)
        if kind < BESIDE:
            along = np.array([np.cos(3 * azimuth), np.sin(3 * azimuth), 0.0]) * rng.choice((-1, 1))
            yield other + 0.25 * along, STEP_M * along
        else:
            along = other / np.linalg.norm(other)
            aside = np.array([along[1], -along[0], 0.0])
            yield other + 0.3 * along + rng.normal(0, 0.25) * aside, 2 * STEP_M * along


def facing(rng: np.random.Generator, at_m: Float64) -> Float64:
    """Draw a rotation (3, 3) of people at a place (3,)."""
    towards = float(np.arctan2(at_m[1], at_m[0])) - np.pi / 2
    turn = rng.normal(towards, 0.6) if rng.random() < FACE_CAMERA else rng.uniform(-np.pi, np.pi)
    return np.asarray(Rotation.from_euler("z", turn).as_matrix(), np.float64)


def _counter(rng: np.random.Generator, figures: Figures) -> Mesh:
    """Draw a counter, a low wall or a board between the camera and a person."""
    person = figures.people[int(rng.integers(len(figures.people)))]
    at = middle(person) * (1, 1, 0)
    near = float((person.vertices_m @ (at / np.linalg.norm(at)).astype(np.float32)).min())
    share = max(near - rng.uniform(0.08, 0.6), 0.4) / np.linalg.norm(at)
    wide, thick, high = rng.uniform((0.15, 0.01, 0.5), (1.2, 0.2, 1.25))
    low = rng.uniform(0, high - 0.2) if rng.random() < 0.25 else 0.0
    turn = Rotation.from_euler("z", np.arctan2(at[1], at[0]) - np.pi / 2 + rng.normal(0, 0.25)).as_matrix()
    shift = rng.normal(0, 0.4) * turn[:, 0]
    return box((-wide, -thick, low), (wide, thick, high), Surface.TABLE).placed(turn, share * at + shift)


def aim(rng: np.random.Generator, eye_m: Float64, middles_m: Sequence[Float64]) -> Pose:
    """Draw ``camera_from_world`` of a camera at ``eye_m`` that roughly looks at one of some places (3,)."""
    target = middles_m[int(rng.integers(len(middles_m)))] + rng.normal(0, 0.3, 3)
    flat = np.array([0.35 * target[0], target[1], 0.0])
    down = np.degrees(np.arctan2(eye_m[2] - target[2], np.linalg.norm(flat)))
    pitch = np.radians(np.clip(down + rng.normal(0, 6), *DOWN_DEG))
    ahead = np.cos(pitch) * flat / np.linalg.norm(flat) - np.array([0.0, 0.0, np.sin(pitch)])
    return look_at(eye_m, eye_m + ahead, np.radians(np.clip(rng.normal(0, 5), -ROLL_DEG, ROLL_DEG)))
