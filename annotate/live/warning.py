"""Warnings about a rig or a frame, and the time that a warning must last before it is shown."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "dark", "glare", "cut off", "far", "shifted", "colours", "flag",
    "drops", "silent", "clock", "disk", "away", "trouble", "fault", "frame",
]  # fmt: skip
HOLD_S = 1.0  # s for which a fault must last before its warning, and be gone afterwards; untuned


@dataclass(frozen=True)
class LiveWarning:
    """Warning of one line with fault, value and remedy. There is at most one active warning of each kind."""

    kind: Kind
    text: str


class ActiveWarnings:
    """Warnings that lasted for ``HOLD_S``, in the order of their first appearance."""

    def __init__(self) -> None:
        self._since: dict[Kind, float] = {}
        self._last: dict[Kind, tuple[float, LiveWarning]] = {}

    def update(self, made: Iterable[LiveWarning], now_s: float) -> tuple[LiveWarning, ...]:
        """Add the warnings of one frame and return the active ones. now_s: on a monotonic clock."""
        for warning in made:
            self._since.setdefault(warning.kind, now_s)
            self._last[warning.kind] = now_s, warning
        for kind, (at_s, _) in list(self._last.items()):
            if now_s - at_s > HOLD_S:
                del self._last[kind], self._since[kind]
        return tuple(self._last[kind][1] for kind, at_s in self._since.items() if now_s - at_s >= HOLD_S)
