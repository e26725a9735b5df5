"""Order of a set's frames: orders, filters, the next frame to do, and reading in advance. No GUI here."""

from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Literal

from annotate.array_types import UInt8
from annotate.correction.correction import Correction
from annotate.correction.replay import STATE_NAMES, State
from annotate.correction.review_queue import (
    Progress,
    confidence_of,
    has_unsure_island,
    is_queued,
    progress,
    review_queue,
)
from annotate.correction.teaching_order import teaching_order
from annotate.gui.state.open_frame import OpenFrame
from annotate.gui.state.scene import FrameScene, SceneReader
from sensors.errors import CloudError

SCENES_KEPT = 6  # in memory: the one shown, the scenes around it, and the one before
Order = Literal["time", "worst", "teach", "review"]
ORDERS: dict[Order, str] = {
    "time": "By time",
    "worst": "Worst first",
    "teach": "Most useful first",
    "review": "For review",
}
Filter = Literal["all", "unfinished"] | State
FILTERS: dict[Filter, str] = {
    "all": "All frames",
    "unfinished": "Unfinished",
    **{state: name.capitalize() for state, name in STATE_NAMES.items()},
}
UNFINISHED: tuple[State, ...] = ("auto", "touched")
FrameRead = tuple[FrameScene, UInt8 | None]
"""A frame as it was read, and the parts (h, w) of the frame before."""


class FrameOrder:
    """Frames of one set in the order of work.

    frame_ids: shown frames. reasons: of the review of each frame.
    """

    def __init__(self, correction: Correction, reader: SceneReader) -> None:
        self.correction = correction
        self._read, self._pool = reader.read, ThreadPoolExecutor(1, "prefetch")
        self._scenes: dict[str, tuple[int, Future[FrameScene]]] = {}
        self.order: Order = "time"
        self.filter: Filter = "all"
        self.all_ids = correction.labels.frame_ids
        self.frame_ids = self.all_ids
        self.reasons: dict[str, str] = {}
        self._confidence: dict[str, float | None] = {}

    def arrange(self, order: Order, kept: Filter, frame_id: str = "") -> None:
        """Choose an order and a filter. frame_id: the open frame, which is shown in any case, or ""."""
        self.order, self.filter = order, kept
        found = [i for i in self.all_ids if i == frame_id or self.passes(i)]
        if order == "review":
            self.reasons = {queued.frame_id: queued.reason for queued in review_queue(self.correction)}
        if order == "worst":
            found.sort(key=self._certainty)
        elif order != "time":
            first = list(self.reasons) if order == "review" else teaching_order(self.correction)
            rank = {i: n for n, i in enumerate(first)}
            found.sort(key=lambda i: rank.get(i, len(rank)))
        self.frame_ids = found

    def _certainty(self, frame_id: str) -> tuple[bool, float]:
        """Return the sort key of the least certain frames first; frames without a confidence are last."""
        known = self.confidence(frame_id)
        island = has_unsure_island(self.correction, frame_id)
        return not island, 2.0 if known is None else known

    def passes(self, frame_id: str) -> bool:
        """Return whether the filter shows a frame."""
        state = self.correction.state(frame_id)
        return self.filter in ("all", state) or (self.filter == "unfinished" and state in UNFINISHED)

    def begin_first(self, restored: Callable[[str, CloudError], bool]) -> OpenFrame:
        """Open the first readable frame; frames that wait for work come first.

        restored: function that offers to rebuild a broken frame and returns whether it was rebuilt. Raises
        the first error, and CloudError for an empty set.
        """
        error = CloudError(f"{self.correction.labels.path} holds no frames; label a recording first")
        for n, frame_id in enumerate(sorted(self.frame_ids, key=lambda i: not self.waits(i))):
            for _ in range(2):
                try:
                    return self.begin(self.read(frame_id))
                except CloudError as reason:
                    error = reason if n == 0 else error
                    if not restored(frame_id, reason):
                        break
        raise error

    def read(self, frame_id: str) -> FrameRead:
        """Read a frame with its current labels, and the parts of the previous frame.

        Any thread may call this. A frame that failed is read again next time. Raises CloudError.
        """
        scene, before = self._scene(frame_id), self.before(frame_id)
        try:
            if before in self._scenes and self._scenes[before][1].done():
                return scene, self._scene(before).labels.parts
            return scene, self.correction.frame(before).parts if before else None
        except CloudError:
            return scene, None

    def _scene(self, frame_id: str) -> FrameScene:
        self._want([frame_id])
        try:
            entries, scene = self._scenes[frame_id]
            known = scene.result()
            if entries == self._entries(frame_id):
                return known
            return replace(known, labels=self.correction.frame(frame_id))
        except BaseException:
            self._scenes.pop(frame_id, None)
            raise

    def _entries(self, frame_id: str) -> int:
        """Return the number of a frame's journal entries, which changes with the labels."""
        return len(self.correction.journal.strokes(frame_id))

    def before(self, frame_id: str) -> str | None:
        """Return the id of the previous frame in time."""
        at = self.all_ids.index(frame_id)
        return self.all_ids[at - 1] if at else None

    def begin(self, read: FrameRead) -> OpenFrame:
        """Open a frame that was just read, and start to read the frames that follow.

        Frames that were edited earlier stay open until ``Correction.leave_others``. Raises CloudError.
        """
        scene, before = read
        frame_id = scene.labels.frame_id
        editor = None if self.correction.read_only else self.correction.begin(scene.labels)
        if frame_id not in self.frame_ids:
            self.arrange(self.order, self.filter, frame_id)
        at = self.frame_ids.index(frame_id)
        ahead = [self.next_unfinished(frame_id), *self.frame_ids[max(0, at - 1) : at + 3], frame_id]
        self._want(i for i in ahead if i)
        return OpenFrame(scene, editor, before)

    def beside(self, frame_id: str, by: int) -> str | None:
        """Return the id of the frame ``by`` places further in the order, or None."""
        at = self.frame_ids.index(frame_id) + by
        return self.frame_ids[at] if 0 <= at < len(self.frame_ids) else None

    def next_unfinished(self, frame_id: str) -> str | None:
        """Return the id of the next frame that waits for work, cyclically; or None."""
        at = self.frame_ids.index(frame_id) + 1
        return next((i for i in (*self.frame_ids[at:], *self.frame_ids[:at]) if self.waits(i)), None)

    def waits(self, frame_id: str) -> bool:
        """Return whether a frame waits for this person: unfinished, or unreviewed in the review order."""
        if self.order == "review":
            return is_queued(self.correction, frame_id)
        return self.correction.state(frame_id) in UNFINISHED

    def all_done(self) -> str:
        """Return a sentence for the case that no shown frame waits: whether other frames are unfinished."""
        if self.order == "review":
            return "Nothing is left to review"
        left = any(self.waits(i) for i in self.all_ids)
        return "No unfinished frame among those shown" if left else "No unfinished frames left"

    def forget(self) -> None:
        """Forget all frames read so far, because labels changed in the background."""
        self._scenes.clear()
        self._confidence.clear()

    def progress(self) -> Progress:
        """Return the progress of the work on the whole set."""
        return progress(self.correction, self.all_ids)

    def confidence(self, frame_id: str) -> float | None:
        """Return the mean confidence of a frame's labels; -1 where its notes are corrupt, None if unknown."""
        if frame_id not in self._confidence:
            self._confidence[frame_id] = confidence_of(self.correction, frame_id)
        return self._confidence[frame_id]

    def close(self) -> None:
        """Stop reading in advance."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _want(self, frame_ids: Iterable[str]) -> None:
        """Start to read frames that are not in memory, and drop the least recently used ones from it."""
        for frame_id in frame_ids:
            known = self._scenes.pop(frame_id, None)
            entries = self._entries(frame_id)
            self._scenes[frame_id] = known or (entries, self._pool.submit(self._read, frame_id))
        for frame_id in list(self._scenes)[:-SCENES_KEPT]:
            self._scenes.pop(frame_id)[1].cancel()
