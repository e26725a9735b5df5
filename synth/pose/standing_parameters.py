"""Ways of standing: parameters of legs, trunk and hands, drawn from a cast's ``poses/standing.toml``."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from annotate.array_types import Float64
from synth.body.skeleton import JOINT_ID, turn
from synth.data_files import TRAINING, Cast, table_of
from synth.pose.pose_parameters import Moment
from synth.surface.furniture import Surface
from synth.surface.rasterize import Mesh, box

SIDES = ("left", "right")
OTHER = {"left": "right", "right": "left"}
GREATEST_TURN_DEG = 60.0  # of the head by itself
ANKLES_M = (0.03, 0.9)  # least and greatest lateral distance


@dataclass(frozen=True)
class Standing:
    """Parameters of a way of standing.

    stance, hands: names in the data; stands: side of the leg that carries more weight. legs: the stance's
    parameters. arms: parameters by side. sizes_m: (3,) of carried objects, by kind. cast: of the names.
    """

    stance: str
    stands: str
    legs: Moment
    hands: Mapping[str, str]
    arms: Mapping[str, Moment]
    sizes_m: Mapping[str, Float64]
    cast: Cast = TRAINING


@cache
def stances(cast: Cast = TRAINING) -> dict[str, dict[str, Any]]:
    """Return a cast's stances by name, each with all its numbers."""
    known: dict[str, dict[str, Any]] = {}
    for name, entry in table_of(cast, "poses/standing")["stances"].items():
        known[name] = {**known.get(entry.get("like", ""), {}), **entry}
    return known


def _chosen(weights: Mapping[str, float], rng: np.random.Generator) -> str:
    left = rng.random() * sum(weights.values())
    for name, weight in weights.items():
        left -= weight
        if left < 0:
            return name
    return name


def _numbers(entry: Mapping[str, Any], rng: np.random.Generator) -> dict[str, float]:
    spreads = {name: spread for name, spread in entry.items() if isinstance(spread, list)}
    means, deviations = np.array(list(spreads.values()), np.float64).T
    return dict(zip(spreads, rng.normal(means, deviations).tolist(), strict=True))


def draw_standing(rng: np.random.Generator, cast: Cast = TRAINING) -> Standing:
    """Draw a cast's way of standing."""
    data = table_of(cast, "poses/standing")
    stance = _chosen({name: entry["share"] for name, entry in stances(cast).items()}, rng)
    entry = stances(cast)[stance]
    legs = _numbers(entry, rng)
    median, deviation = entry["ankles"]
    apart = float(np.clip(abs(median) * np.exp(deviation * rng.standard_normal()), *ANKLES_M))
    legs["ankles"] = np.copysign(apart, median)
    while abs(legs["turn"]) > GREATEST_TURN_DEG:
        legs["turn"] = float(rng.normal(*entry["turn"]))
    stands, first = (SIDES[int(rng.integers(2))] for _ in range(2))
    pair = _chosen(data["arms"][entry["arms"]], rng).split("-")
    hands = {first: pair[0], OTHER[first]: pair[1]}
    arms = {side: _numbers(data["hands"][hands[side]], rng) for side in SIDES}
    sizes = {kind: np.array([rng.uniform(*span) for span in spans]) for kind, spans in data["things"].items()}
    return Standing(stance, stands, legs, hands, arms, sizes, cast)


def carried(how: Standing, joints: Float64) -> list[Mesh]:
    """Return boxes, trays and bags in the hands of a person with joints (J, 3), world, metres."""
    wrists = {side: joints[JOINT_ID[f"{side}_wrist"]] for side in SIDES}
    across = wrists["left"] - wrists["right"]
    heading = turn(2, float(np.arctan2(across[1], across[0])))
    things = []
    for kind in ("box", "tray"):
        if how.hands["left"] == how.hands["right"] == kind:
            size = how.sizes_m[kind].copy()
            size[0] = np.clip(np.hypot(*across[:2]) + (-0.05 if kind == "box" else 0.12), 0.1, 0.6)
            middle = (wrists["left"] + wrists["right"]) / 2
            lift = size[2] / 2 + 0.03 if kind == "tray" else 0.0
            things.append(_block(size, middle + heading @ (0.0, -0.05 - size[1] / 2 + 0.06, lift), heading))
    for side in SIDES:
        if how.hands[side] == "bag":
            size = how.sizes_m["bag"]
            things.append(_block(size, wrists[side] - (0.0, 0.0, 0.12 + size[2] / 2), np.eye(3)))
    return things


def _block(size: Float64, centre: Float64, rotation: Float64) -> Mesh:
    half = tuple(size / 2)
    return box((-half[0], -half[1], -half[2]), half, Surface.TABLE).placed(rotation, centre)
