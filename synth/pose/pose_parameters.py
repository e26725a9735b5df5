"""Moments (named pose parameters) of sitting, lying or standing people; families of moments, drawn and
interpolated.

A family's activities are data (``synth/data/poses/*.toml``). Every family has its own function that poses a
body. Constants are untuned.
"""

from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from annotate.array_types import Float32, Float64
from synth.body.body import Body
from synth.data_files import CASTS, TRAINING, Cast, table_of

Moment = Mapping[str, float]  # numbers by name: degrees, metres and shares
Posed = tuple[Float32, Float64]  # vertices (V, 3) and joints (J, 3) of a posed body, world, metres
Spreads = dict[str, tuple[float, float]]  # mean and standard deviation by name

KEY_SECONDS = (0.6, 2.5)  # least and greatest seconds from one drawn moment to the next
PACE_PER_S = 110.0  # greatest mean change of a number in a glide, degrees; metres and shares never come near
SHARE_AT_REST = 0.6  # of single images in mid-activity; the others glide to another one
NEARLY_THERE = 0.25  # share of the way to another activity up to which a moment belongs to the first
# numbers that change their sign when left and right are exchanged
_TO_THE_LEFT = {"heading", "roll", "off", "lean", "twist", "turn", "hand_x"}
# Postures of upright activities; getting up lies between two postures.
_ON_THE_FLOOR = {
    "standing": "standing",
    "stooping": "standing",
    "crouching": "crouching",
    "cowering": "crouching",
    "squatting": "crouching",
    "kneeling": "kneeling",
    "kneeling_on_heels": "kneeling",
    "half_kneeling_left": "kneeling",
    "half_kneeling_right": "kneeling",
    "all_fours": "on all fours",
    # Of the judging cast.
    "waiting": "standing",
    "bowing": "standing",
    "looking_behind": "standing",
    "leaning_on_thighs": "standing",
    "deep_squat": "crouching",
    "tying_shoe": "crouching",
    "kneeling_bowed": "kneeling",
    "proposing_right": "kneeling",
    "proposing_left": "kneeling",
    "reaching_on_fours": "on all fours",
}


@dataclass(frozen=True)
class PoseFamily:
    """Family of moments (pose parameters). base: distribution of every parameter; activities: other
    distributions by activity.
    """

    base: Spreads
    activities: dict[str, Spreads]

    def draw(self, activity: str, rng: np.random.Generator) -> Moment:
        spreads = {**self.base, **self.activities[activity]}
        return {name: float(rng.normal(*spread)) for name, spread in spreads.items()}

    def single(self, rng: np.random.Generator) -> tuple[tuple[str, ...], Moment]:
        """Draw a moment of one activity, or between two; return the activities, the nearer first, and the
        moment.
        """
        names = tuple(self.activities)
        first = str(rng.choice(names))
        second = first if rng.random() < SHARE_AT_REST else str(rng.choice(names))
        start, end, share = self.draw(first, rng), self.draw(second, rng), float(rng.random())
        way = _eased(share)
        nearer, other = (first, second) if way <= 0.5 else (second, first)
        between = first != second and min(way, 1 - way) > NEARLY_THERE
        return (nearer, other) if between else (nearer,), glide(start, end, share)


@dataclass(frozen=True)
class Behaviour:
    """Activities of a pose family at one location, and the function that poses a body at a moment."""

    family: PoseFamily
    activities: tuple[str, ...]
    pose: Callable[[Body, Moment], Posed]

    def draw(self, rng: np.random.Generator) -> Moment:
        return self.family.draw(str(rng.choice(self.activities)), rng)

    def stream(self, rng: np.random.Generator, frames_per_second: float) -> Iterator[Moment]:
        """Yield an endless stream of moments: activity after activity, with smooth interpolation between key
        moments.
        """
        current = self.draw(rng)
        while True:
            activity = str(rng.choice(self.activities))
            for _ in range(int(rng.integers(2, 5))):
                following = self.family.draw(activity, rng)
                change = max(abs(following[name] - current[name]) for name in current)
                seconds = max(rng.uniform(*KEY_SECONDS), change / PACE_PER_S)
                steps = max(1, round(seconds * frames_per_second))
                yield from (glide(current, following, i / steps) for i in range(steps))
                current = following


def glide(start: Moment, end: Moment, share: float) -> Moment:
    """Return the moment interpolated between two, starting and ending at rest (smoothstep). share: in
    [0, 1].
    """
    s = _eased(share)
    return {name: (1 - s) * start[name] + s * end[name] for name in start}


def _eased(share: float) -> float:
    return share * share * (3 - 2 * share)


@cache
def pose_families(file: str, cast: Cast = TRAINING) -> dict[str, PoseFamily]:
    """Return the families of a cast's ``poses/FILE.toml`` by the table of their activities."""
    tables = deepcopy(table_of(cast, f"poses/{file}"))
    base = _spreads(tables.pop("base"))
    known: dict[str, Spreads] = {}
    for activities in tables.values():
        for name, entry in activities.items():
            like = known[entry.pop("like")] if "like" in entry else {}
            known[name] = mirrored(known[entry.pop("mirrored")]) if "mirrored" in entry else like
            known[name] = {**known[name], **_spreads(entry)}
    return {table: PoseFamily(base, {name: known[name] for name in tables[table]}) for table in tables}


def mirrored(spreads: Spreads) -> Spreads:
    """Return the distributions of pose parameters with left and right exchanged."""
    other = {"left": "right", "right": "left"}
    result = {}
    for name, (mean, deviation) in spreads.items():
        side, _, rest = name.partition("_")
        sided = side in other
        turns = (rest if sided else name) in _TO_THE_LEFT
        result[f"{other[side]}_{rest}" if sided else name] = (-mean if turns else mean, deviation)
    return result


def _spreads(entry: dict[str, list[float]]) -> Spreads:
    """Read a table of distributions; ``both_NAME`` stands for left_NAME and right_NAME."""
    result: Spreads = {}
    for name, (mean, deviation) in entry.items():
        spread = (float(mean), float(deviation))
        if name.startswith("both_"):
            left = {f"left_{name.removeprefix('both_')}": spread}
            result |= {**left, **mirrored(left)}
        else:
            result[name] = spread
    return result


def posture_class(*activities: str) -> str | None:
    """Return the posture (of ``annotate.posture.POSTURES``) that all activities have, None if they differ."""
    postures = {_postures().get(activity) for activity in activities}
    return postures.pop() if len(postures) == 1 else None


@lru_cache(maxsize=1)
def _postures() -> dict[str, str]:
    known: dict[str, str] = {}
    for cast in CASTS:
        sitting, recumbent, standing = (
            table_of(cast, f"poses/{name}") for name in ("sitting", "recumbent", "standing")
        )
        known |= dict.fromkeys(sitting["sitting"], "sitting")
        known |= dict.fromkeys([*recumbent["in_bed"], *recumbent["fallen"]], "lying")
        known |= dict.fromkeys(standing["stances"], "standing")
    return known | _ON_THE_FLOOR
