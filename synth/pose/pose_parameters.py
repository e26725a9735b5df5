"""Moments: named numbers that describe somebody who sits, lies or stands; families of them, drawn and glided.

A family's activities are data (``synth/data/poses/*.toml``). Every family has its own way of turning a moment
into a posed body; drawing, gliding and the stream of moments are here, once.
"""

from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from annotate.array_types import Float32, Float64
from synth.body.body import Body
from synth.data_files import table

Moment = Mapping[str, float]
"""Numbers by name: degrees, metres and shares."""
Posed = tuple[Float32, Float64]
"""A posed body: vertices (V, 3) and joints (J, 3), world, metres."""
Spreads = dict[str, tuple[float, float]]
"""Mean and standard deviation by name."""

KEY_SECONDS = (0.6, 2.5)
"""Seconds from one drawn moment to the next, least and most. No source: chosen by eye."""
PACE_PER_S = 110.0
"""No number changes faster than this on the mean of a glide: degrees (metres and shares never come near).
No source: chosen by eye."""
SHARE_AT_REST = 0.6
"""Of single images, those in mid-activity; the others glide to another one. No source: chosen by eye."""
NEARLY_THERE = 0.25
"""Share of the way to another activity up to which a moment is one of the first. No source: chosen by eye."""
_TO_THE_LEFT = {"heading", "roll", "off", "lean", "twist", "turn", "hand_x"}
"""Numbers that change their sign when left and right are exchanged."""
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
}
"""Upright and standing people; somebody who gets up is between two postures and has none."""


@dataclass(frozen=True)
class PoseFamily:
    """Moments of one kind. base: every number's spread; activities: what differs from it, by name."""

    base: Spreads
    activities: dict[str, Spreads]

    def draw(self, activity: str, rng: np.random.Generator) -> Moment:
        """A random moment of an activity."""
        spreads = {**self.base, **self.activities[activity]}
        return {name: float(rng.normal(*spread)) for name, spread in spreads.items()}

    def single(self, rng: np.random.Generator) -> tuple[tuple[str, ...], Moment]:
        """A moment of one activity, or on the way to another; its name, or both, the nearer one's first."""
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
    """What somebody does in one place. activities: those of the family done here; pose: of a body."""

    family: PoseFamily
    activities: tuple[str, ...]
    pose: Callable[[Body, Moment], Posed]

    def draw(self, rng: np.random.Generator) -> Moment:
        """A moment of any activity."""
        return self.family.draw(str(rng.choice(self.activities)), rng)

    def stream(self, rng: np.random.Generator, frames_per_second: float) -> Iterator[Moment]:
        """An endless stream: activity after activity, gliding from one key moment to the next."""
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
    """The moment a share in [0, 1] of the way, starting and ending at rest (smoothstep)."""
    s = _eased(share)
    return {name: (1 - s) * start[name] + s * end[name] for name in start}


def _eased(share: float) -> float:
    return share * share * (3 - 2 * share)


@cache
def pose_families(file: str) -> dict[str, PoseFamily]:
    """Families of ``synth/data/poses/FILE.toml`` by the table that holds their activities."""
    tables = deepcopy(table(f"poses/{file}"))
    base = _spreads(tables.pop("base"))
    known: dict[str, Spreads] = {}
    for activities in tables.values():
        for name, entry in activities.items():
            like = known[entry.pop("like")] if "like" in entry else {}
            known[name] = mirrored(known[entry.pop("mirrored")]) if "mirrored" in entry else like
            known[name] = {**known[name], **_spreads(entry)}
    return {table: PoseFamily(base, {name: known[name] for name in tables[table]}) for table in tables}


def mirrored(spreads: Spreads) -> Spreads:
    """The same activity with left and right exchanged."""
    other = {"left": "right", "right": "left"}
    result = {}
    for name, (mean, deviation) in spreads.items():
        side, _, rest = name.partition("_")
        sided = side in other
        turns = (rest if sided else name) in _TO_THE_LEFT
        result[f"{other[side]}_{rest}" if sided else name] = (-mean if turns else mean, deviation)
    return result


def _spreads(entry: dict[str, list[float]]) -> Spreads:
    """Spreads of a table, ``both_NAME`` as left_NAME and right_NAME."""
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
    """Posture that activities of ``synth/data/poses`` share; None between two, or of one not known."""
    postures = {_postures().get(activity) for activity in activities}
    return postures.pop() if len(postures) == 1 else None


@lru_cache(maxsize=1)
def _postures() -> dict[str, str]:
    recumbent = table("poses/recumbent")
    return {
        **dict.fromkeys(table("poses/sitting")["sitting"], "sitting"),
        **dict.fromkeys([*recumbent["in_bed"], *recumbent["fallen"]], "lying"),
        **dict.fromkeys(table("poses/standing")["stances"], "standing"),
        **_ON_THE_FLOOR,
    }
