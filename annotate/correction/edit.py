"""Editor of one frame's labels: each operation is one stroke, and active time is measured."""

import time
from collections.abc import Callable, Iterable
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Int64, UInt8
from annotate.cleanup import neighbours
from annotate.correction.history import History
from annotate.frame_labels import FrameLabels
from annotate.labelset.stroke import (
    KEY,
    Activity,
    Gesture,
    Operation,
    Stroke,
    Verdict,
    difference,
)
from annotate.scheme.scheme import BACKGROUND, UNDEFINED
from sensors.errors import CloudError

IDLE_S = 120.0  # longest gap between two events that counts; longer ones are breaks (inception #5909)
_EPOCH_S = time.time() - time.clock_gettime(time.CLOCK_BOOTTIME)


def steady_time() -> float:
    """Return the seconds since the epoch; setting the host's clock has no effect."""
    return _EPOCH_S + time.clock_gettime(time.CLOCK_BOOTTIME)


class ActiveTime:
    """Active time by activity: sum of gaps up to ``IDLE_S`` between a person's events. clock: seconds since
    the epoch.
    """

    def __init__(self, clock: Callable[[], float] = steady_time) -> None:
        self.clock = clock
        self._last: float | None = None
        self._seconds: dict[Activity, float] = {}

    def mark(self, kind: Activity) -> None:
        """Count the time since the previous event (key, click, camera move) for an activity."""
        now = self.clock()
        if self._last is not None and 0 < now - self._last <= IDLE_S:
            self._seconds[kind] = self._seconds.get(kind, 0.0) + (now - self._last)
        self._last = now

    def take(self) -> dict[Activity, float]:
        """Return the seconds by activity since the last call, rounded to the millisecond."""
        taken, self._seconds = self._seconds, {}
        return {kind: round(seconds, 3) for kind, seconds in taken.items()}

    def now(self) -> str:
        """Return the clock's time as ISO 8601 in UTC."""
        return datetime.fromtimestamp(self.clock(), UTC).isoformat(timespec="milliseconds")


class Editor:
    """Editor of the labels of one frame.

    valid (h, w): pixels with depth, the only ones that can get a part. locks: ids of parts that neither lose
    nor gain pixels. only: the one part that may be replaced, or None for any. record: called with every
    stroke after its effect; its errors pass through. Operations return the stroke, or None for no change, and
    raise CloudError on part ids and pixels that do not exist. ``pixels`` are flat indices (n,) into the
    image, or a mask (h, w).
    """

    def __init__(
        self,
        frame: FrameLabels,
        who: str,
        record: Callable[[Stroke], None] = lambda stroke: None,
        time: ActiveTime | None = None,
        history: History | None = None,
    ) -> None:
        self.frame_id, self.depth_mm, self.who = frame.frame_id, frame.depth_mm, who
        self.scheme = frame.scheme
        self.valid: Bool = frame.depth_mm > 0
        self.time = time or ActiveTime()
        self.history = history or History()
        self.locks: set[int] = set()
        self.only: int | None = None
        self._parts = np.ascontiguousarray(frame.parts).copy()
        self._record = record

    @property
    def parts(self) -> UInt8:
        """Return the part ids (h, w) as a read-only view of the current labels."""
        view = self._parts.view()
        view.flags.writeable = False
        return view

    def paint(self, pixels: NDArray[np.generic], part: int, how: Gesture = KEY) -> Stroke | None:
        """Set the label of pixels to a part; 0 is background, 255 undefined."""
        self._known(part)
        return self._give("paint", self._flat(pixels), part, how)

    def to_neighbour(self, pixels: NDArray[np.generic], how: Gesture = KEY) -> Stroke | None:
        """Set the label of pixels to the neighbouring part with the longest contact."""
        at = self._flat(pixels)
        found = neighbours(self._parts, at, self.scheme)
        return self._give("to_neighbour", at, found[0], how) if found else None

    def swap_left_right(
        self, pairs: Iterable[tuple[int, int]] | None = None, how: Gesture = KEY
    ) -> Stroke | None:
        """Exchange left and right parts of a limb, or all (None).

        A pair with a locked part is not exchanged. pairs: of ids, left and right.
        """
        table = np.arange(256, dtype=np.uint8)
        for left, right in self.scheme.twins if pairs is None else pairs:
            if not {left, right} & self.locks:
                table[left], table[right] = right, left
        return self.replace("swap_left_right", table[self._parts], None, how)

    def merge(self, source: int, target: int, how: Gesture = KEY) -> Stroke | None:
        """Replace one part by another in the whole frame."""
        self._known(source)
        self._known(target)
        merged = np.where(self._parts == source, np.uint8(target), self._parts)
        return self.replace("merge", merged, target, how)

    def copy_previous(self, parts: UInt8, how: Gesture = KEY) -> Stroke | None:
        """Copy another frame's parts (h, w) to the pixels that carry a part in both frames."""
        self._same_shape(parts)
        both = (self._parts != BACKGROUND) & self.scheme.on_part(parts)
        return self.replace("copy_previous", np.where(both, parts, self._parts), None, how)

    def replace(
        self, operation: Operation, parts: UInt8, part: int | None = None, how: Gesture = KEY
    ) -> Stroke | None:
        """Replace the labels by others (h, w) at pixels that depth, locks and ``only`` allow."""
        at = self.preview(parts)
        return self._change(operation, at, parts.ravel()[at], part, how)

    def preview(self, parts: UInt8) -> Int64:
        """Return the flat indices of the pixels that ``replace`` would change."""
        self._same_shape(parts)
        at = np.flatnonzero(parts != self._parts)
        return at[self._allowed(at, parts.ravel()[at])]

    def undo(self, how: Gesture = KEY) -> Stroke | None:
        """Undo the last stroke or verdict."""
        return self._again("undo", self.history.done, how)

    def redo(self, how: Gesture = KEY) -> Stroke | None:
        """Redo the last undone stroke or verdict."""
        return self._again("redo", self.history.undone, how)

    def judge(self, verdict: Verdict, reason: str = "", how: Gesture = KEY) -> Stroke:
        """Record a verdict. Raises CloudError for a rejection without reason."""
        if verdict == "reject" and not reason.strip():
            raise CloudError("the rejection has no reason; write the reason in a few words")
        return self._do(verdict, _NONE, None, how, " ".join(reason.split()))

    def leave(self) -> Stroke | None:
        """Record the time spent since the last stroke, if any."""
        seconds = self.time.take()
        if not seconds:
            return None
        stroke = Stroke(self.frame_id, "leave", _NONE, None, Gesture(), self.who, self.time.now(), seconds)
        self._record(stroke)
        return stroke

    def _again(self, operation: Operation, stack: list[Stroke], how: Gesture) -> Stroke | None:
        if not stack:
            return None
        last = stack[-1]
        runs = last.inverse_runs() if operation == "undo" else last.runs
        return self._do(operation, runs, last.part, how)

    def _give(self, operation: Operation, at: Int64, part: int, how: Gesture) -> Stroke | None:
        new = np.full(len(at), part, np.uint8)
        allowed = self._allowed(at, new)
        return self._change(operation, at[allowed], new[allowed], part, how)

    def _change(
        self, operation: Operation, at: Int64, new: UInt8, part: int | None, how: Gesture
    ) -> Stroke | None:
        runs = difference(at, self._parts.ravel()[at], new)
        return self._do(operation, runs, part, how) if len(runs) else None

    def _do(
        self, operation: Operation, runs: Int64, part: int | None, how: Gesture, reason: str = ""
    ) -> Stroke:
        self.time.mark("painting" if len(runs) else "looking")
        now, seconds = self.time.now(), self.time.take()
        stroke = Stroke(self.frame_id, operation, runs, part, how, self.who, now, seconds, reason)
        self.history.add(stroke)
        stroke.apply_to(self._parts)
        self._record(stroke)
        return stroke

    def _allowed(self, at: Int64, new: UInt8) -> Bool:
        """Return whether each flat pixel (n,) may become ``new``, by depth, locks and ``only``."""
        old = self._parts.ravel()[at]
        bare = (new == BACKGROUND) | (new == UNDEFINED)
        allowed = bare & (old != BACKGROUND) | self.valid.ravel()[at]
        if self.locks:
            locked = np.zeros(256, np.bool_)
            locked[list(self.locks)] = True
            allowed &= ~(locked[old] | locked[new])
        if self.only is not None:
            allowed &= old == self.only
        return np.asarray(allowed)

    def _flat(self, pixels: NDArray[np.generic]) -> Int64:
        """Return flat indices, sorted and unique, of ``pixels``."""
        pixels = np.asarray(pixels)
        if pixels.dtype == np.bool_:
            self._same_shape(pixels)
            return np.flatnonzero(pixels)
        if pixels.size and not 0 <= int(pixels.min()) <= int(pixels.max()) < self._parts.size:
            raise CloudError(
                f"pixel indices are {pixels.min()} to {pixels.max()}; give 0 to {self._parts.size - 1}"
            )
        return np.unique(pixels.astype(np.int64))

    def _known(self, part: int) -> None:
        if not (0 <= part <= UNDEFINED and self.scheme.is_label[part]):
            raise CloudError(
                f"part id {part} is unknown in scheme {self.scheme.name!r}; use {self.scheme.label_text}"
            )

    def _same_shape(self, image: NDArray[np.generic]) -> None:
        if image.shape != self._parts.shape:
            raise CloudError(f"an image of labels or a mask is {image.shape}; give {self._parts.shape}")


_NONE = np.empty((0, 4), np.int64)
