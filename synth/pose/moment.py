"""A moment is a vector of named numbers; an activity draws it; motion glides from one to the next.

Every family of poses (sitting, recumbent, upright) is a ``Family`` of such moments with its own way of
turning one into a body; drawing, gliding and the stream of moments are here, once.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any, Generic, TypeVar

import numpy as np

M = TypeVar("M", bound=Any)
Spread = tuple[float, float]
"""Mean and standard deviation."""

KEY_SECONDS = (0.6, 2.5)
"""Time from one drawn moment to the next."""
PACE_PER_S = 110.0
"""No number changes faster than this on the mean of a glide: degrees (metres and shares never come near)."""


@dataclass(frozen=True)
class Family(Generic[M]):
    """Moments of one kind. kind: a dataclass of floats; base: every field's spread; activities: changes."""

    kind: Callable[..., M]
    base: Mapping[str, Spread]
    activities: Mapping[str, Mapping[str, Spread]]

    def draw(self, activity: str, rng: np.random.Generator) -> M:
        """A random moment of an activity."""
        spreads = {**self.base, **self.activities[activity]}
        moment: M = self.kind(**{name: float(rng.normal(*spread)) for name, spread in spreads.items()})
        return moment

    def moments(
        self, rng: np.random.Generator, frames_per_second: float, activities: tuple[str, ...]
    ) -> Iterator[M]:
        """An endless stream: activity after activity, gliding from one key moment to the next."""
        current = self.draw(str(rng.choice(activities)), rng)
        while True:
            activity = str(rng.choice(activities))
            for _ in range(int(rng.integers(2, 5))):
                following = self.draw(activity, rng)
                seconds = max(rng.uniform(*KEY_SECONDS), _largest_change(current, following) / PACE_PER_S)
                steps = max(1, round(seconds * frames_per_second))
                yield from (glide(current, following, i / steps) for i in range(steps))
                current = following


def glide(start: M, end: M, share: float) -> M:
    """The moment a share in [0, 1] of the way, starting and ending at rest (smoothstep)."""
    s = share * share * (3 - 2 * share)
    names = (f.name for f in fields(start))
    between: M = type(start)(
        **{name: (1 - s) * getattr(start, name) + s * getattr(end, name) for name in names}
    )
    return between


def _largest_change(start: M, end: M) -> float:
    return max(abs(float(getattr(end, f.name) - getattr(start, f.name))) for f in fields(start))
