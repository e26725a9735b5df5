"""The operations that change one frame's labels. No window and no file here.

Every operation computes its result first and then replaces, by one stroke; ``undo`` takes back one stroke.
"""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Int64, UInt8
from annotate.cleanup import filled, neighbours, without_islands
from annotate.correction.activity import ActiveTime
from annotate.correction.history import History
from annotate.frame_labels import FrameLabels
from annotate.labelset.stroke import KEY, Gesture, Operation, Stroke, difference, is_part
from annotate.parts import BACKGROUND, LEFT_RIGHT, UNDEFINED
from sensors.errors import CloudError

ARMS, LEGS = LEFT_RIGHT[:2], LEFT_RIGHT[2:]
"""The limbs that can be confused with each other, as (left, right) pairs."""
SAME_DEPTH = 0.05
"""Largest depth difference of the same surface from one frame to the next, as a share of depth: 10 cm at 2 m.
Chosen by eye."""


class Editor:
    """One frame's labels under correction.

    frame_id; depth_mm (h, w); valid (h, w): pixels with depth, the only ones that can get a part.
    locks: part ids whose pixels stay as they are: a locked part neither loses nor gains any. With the
    background locked, the person's outline stays.
    only: the one part that may be replaced, or None for any.
    who: the person's name. time: their active time. history: the strokes to undo and redo, without limit.

    Operations return the stroke, or None when nothing would change. They raise CloudError on part ids and
    pixels that do not exist, and what ``record`` raises: the stroke took effect nevertheless.
    ``record`` is called with every stroke after it took effect (``correction`` writes the journal there).
    ``pixels`` are flat indices (n,) into the image, or a mask (h, w).
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
        self.valid: Bool = frame.depth_mm > 0
        self.time = time or ActiveTime()
        self.history = history or History()
        self.locks: set[int] = set()
        self.only: int | None = None
        self._parts = np.ascontiguousarray(frame.parts).copy()
        self._record = record

    @property
    def parts(self) -> UInt8:
        """Part ids (h, w) after the last stroke; a read-only view that follows every stroke."""
        view = self._parts.view()
        view.flags.writeable = False
        return view

    # Changes of labels

    def paint(self, pixels: NDArray[np.generic], part: int, how: Gesture = KEY) -> Stroke | None:
        """Give pixels a part: 0 for background, 255 for undefined."""
        _known(part)
        at = self._flat(pixels)
        return self._change("paint", at, np.full(len(at), part, np.uint8), part, how)

    def fill_holes(self, part: int, how: Gesture = KEY) -> Stroke | None:
        """Give a part the holes in its surface (``cleanup.filled``)."""
        _known(part)
        return self.replace("fill_holes", filled(self._parts, self.depth_mm, part), part, how)

    def remove_islands(self, part: int | None = None, how: Gesture = KEY) -> Stroke | None:
        """Give the islands of a part, or of all, to the parts they touch (``cleanup.without_islands``)."""
        return self.replace("remove_islands", without_islands(self._parts, self.depth_mm, part), part, how)

    def swap_left_right(
        self,
        pairs: Iterable[tuple[int, int]] = LEFT_RIGHT,
        pixels: NDArray[np.generic] | None = None,
        how: Gesture = KEY,
    ) -> Stroke | None:
        """Exchange left and right parts: ARMS, LEGS or all; in some pixels, or in all.

        A pair with a locked part is not exchanged.
        """
        table = np.arange(256, dtype=np.uint8)
        for left, right in pairs:
            if not {left, right} & self.locks:
                table[left], table[right] = right, left
        at = self._flat(pixels)
        return self._change("swap_left_right", at, table[self._parts.ravel()[at]], None, how)

    def merge(
        self, source: int, target: int, pixels: NDArray[np.generic] | None = None, how: Gesture = KEY
    ) -> Stroke | None:
        """Turn one part into another: all of ``source``, or its pixels among some, become ``target``."""
        _known(source)
        _known(target)
        at = self._flat(pixels)
        at = at[self._parts.ravel()[at] == source]
        return self._change("merge", at, np.full(len(at), target, np.uint8), target, how)

    def neighbours(self, pixels: NDArray[np.generic]) -> list[int]:
        """Part ids that these pixels touch, the one with the longest border first."""
        return neighbours(self._parts, self._flat(pixels))

    def to_neighbour(self, pixels: NDArray[np.generic], choice: int = 0, how: Gesture = KEY) -> Stroke | None:
        """Give pixels to the neighbouring part that they touch most. choice: 1 for the second most."""
        at = self._flat(pixels)
        found = neighbours(self._parts, at)
        if not 0 <= choice < len(found):
            return None
        return self._change("to_neighbour", at, np.full(len(at), found[choice], np.uint8), found[choice], how)

    def copy_previous(
        self, previous: FrameLabels, pixels: NDArray[np.generic] | None = None, how: Gesture = KEY
    ) -> Stroke | None:
        """Copy the labels of another frame where it shows the same surface: at nearly the same depth."""
        self._same_shape(previous.parts)
        at = self._flat(pixels)
        now, then = (depth.ravel()[at].astype(np.float32) for depth in (self.depth_mm, previous.depth_mm))
        same = (then > 0) & (np.abs(now - then) <= SAME_DEPTH * now)
        at = at[same]
        return self._change("copy_previous", at, previous.parts.ravel()[at], None, how)

    def propagate(self, parts: UInt8, how: Gesture = KEY) -> Stroke | None:
        """Replace the labels by propagated ones (h, w), except where those are undefined."""
        self._same_shape(parts)
        return self.replace("propagate", np.where(parts == UNDEFINED, self._parts, parts), None, how)

    def replace(
        self, operation: Operation, parts: UInt8, part: int | None = None, how: Gesture = KEY
    ) -> Stroke | None:
        """Replace the labels by others (h, w), as far as locks and ``only`` allow."""
        self._same_shape(parts)
        at = np.flatnonzero(parts != self._parts)
        return self._change(operation, at, parts.ravel()[at], part, how)

    def preview(self, parts: UInt8) -> Int64:
        """Flat indices of the pixels that ``replace`` by these labels (h, w) would change."""
        self._same_shape(parts)
        at = np.flatnonzero(parts != self._parts)
        return at[self._allowed(at, parts.ravel()[at])]

    # Undo and redo

    def undo(self, how: Gesture = KEY) -> Stroke | None:
        """Take back the last stroke; None when there is none."""
        return self._again("undo", self.history.done, how)

    def redo(self, how: Gesture = KEY) -> Stroke | None:
        """Do again what was undone last; None when there is nothing."""
        return self._again("redo", self.history.undone, how)

    # Verdicts and time

    def accept(self, how: Gesture = KEY) -> Stroke:
        """The annotator accepts the frame."""
        return self._judge("accept", how)

    def agree(self, how: Gesture = KEY) -> Stroke:
        """A reviewer agrees with the accepted frame."""
        return self._judge("agree", how)

    def reject(self, reason: str, how: Gesture = KEY) -> Stroke:
        """Reject the frame for a reason, one line. Raises CloudError without one."""
        if not reason.strip():
            raise CloudError("a rejection needs a reason; write in a few words what is wrong")
        return self._judge("reject", how, " ".join(reason.split()))

    def leave(self) -> Stroke | None:
        """Record the time spent since the last stroke; None when there was none."""
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

    def _judge(self, operation: Operation, how: Gesture, reason: str = "") -> Stroke:
        return self._do(operation, _NONE, None, how, reason)

    def _change(
        self, operation: Operation, at: Int64, new: UInt8, part: int | None, how: Gesture
    ) -> Stroke | None:
        allowed = self._allowed(at, new)
        at, new = at[allowed], new[allowed]
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
        """Whether each of the flat pixels (n,) may become ``new``, by depth, locks and ``only``."""
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

    def _flat(self, pixels: NDArray[np.generic] | None) -> Int64:
        """Sorted flat indices, each once."""
        if pixels is None:
            return np.arange(self._parts.size)
        pixels = np.asarray(pixels)
        if pixels.dtype == np.bool_:
            self._same_shape(pixels)
            return np.flatnonzero(pixels)
        if pixels.size and not 0 <= int(pixels.min()) <= int(pixels.max()) < self._parts.size:
            raise CloudError(f"pixels reach outside the image of {self._parts.size}; give flat indices")
        mask = np.zeros(self._parts.size, np.bool_)
        mask[pixels.astype(np.int64)] = True
        return np.flatnonzero(mask)

    def _same_shape(self, image: NDArray[np.generic]) -> None:
        if image.shape != self._parts.shape:
            raise CloudError(f"labels or a mask of {image.shape} do not fit frame {self._parts.shape}")


_NONE = np.empty((0, 4), np.int64)


def _known(part: int) -> None:
    if not is_part(part):
        raise CloudError(f"part id {part} is unknown; use 0 to 11, or 255 for undefined")
