"""Complaints about a rig or a picture, while it can still be fixed; how long one lasts before it is shown."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "dark", "glare", "cut off", "far", "shifted", "colours", "flag",
    "drops", "silent", "clock", "disk", "away", "trouble", "fault", "frame",
]  # fmt: skip
"""Kinds of complaints; of each there is one at a time."""
HOLD_S = 1.0
"""Seconds for which something must be wrong before it is said, and right before it is taken back. Chosen by
eye: somebody walks through the picture in that time."""


@dataclass(frozen=True)
class LiveWarning:
    """kind: what it is about. text: what is wrong, the value, and the remedy, in one line."""

    kind: Kind
    text: str


class ActiveWarnings:
    """The complaints that stand: those that were made for ``HOLD_S``, in the order in which they arose."""

    def __init__(self) -> None:
        self._since: dict[Kind, float] = {}
        self._last: dict[Kind, tuple[float, LiveWarning]] = {}

    def update(self, made: Iterable[LiveWarning], now_s: float) -> tuple[LiveWarning, ...]:
        """The complaints that stand after those of a moment; now_s: seconds on a clock that only rises."""
        for warning in made:
            self._since.setdefault(warning.kind, now_s)
            self._last[warning.kind] = now_s, warning
        for kind, (at_s, _) in list(self._last.items()):
            if now_s - at_s > HOLD_S:
                del self._last[kind], self._since[kind]
        return tuple(
            self._last[kind][1] for kind, since_s in self._since.items() if now_s - since_s >= HOLD_S
        )
