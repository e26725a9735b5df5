"""The frames of a set in order: the next one to do, orders and filters, and reading ahead. No window here."""

from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Literal

from annotate.array_types import UInt8
from annotate.correction.correction import Correction
from annotate.correction.edit import Editor
from annotate.correction.replay import STATE_NAMES, State
from annotate.correction.review_queue import (
    Progress,
    confidence_of,
    is_queued,
    progress,
    review_queue,
    teaching_order,
)
from annotate.gui.state.scene import FrameScene, SceneReader
from sensors.errors import CloudError

SCENES_KEPT = 6
"""Number of scenes in memory: the one shown, those around it, and the one before. Untuned."""
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


@dataclass(frozen=True)
class Opened:
    """A frame for the desk. editor: None where the set is open read-only. before: parts (h, w) of the frame
    before in time, None where there is none that can be read."""

    scene: FrameScene
    editor: Editor | None
    before: UInt8 | None


class Walk:
    """The frames of one set. frame_ids: those shown, in order. reasons: by frame, for reviewers."""

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
        """Choose an order and a filter; the frame that is open, if any, is shown whatever they are."""
        self.order, self.filter = order, kept
        found = [i for i in self.all_ids if i == frame_id or self.passes(i)]
        if order == "review":
            queue = review_queue(self.correction)
            self.reasons = {queued.frame_id: queued.reason for queued in queue}
            rank = {i: n for n, i in enumerate(self.reasons)}
            found.sort(key=lambda i: rank.get(i, len(rank)))
        elif order == "worst":
            found.sort(key=lambda i: 2.0 if (known := self.confidence(i)) is None else known)
        elif order == "teach":
            place = {i: n for n, i in enumerate(teaching_order(self.correction))}
            found.sort(key=lambda i: place.get(i, len(place)))
        self.frame_ids = found

    def passes(self, frame_id: str) -> bool:
        """Return whether the filter shows a frame."""
        state = self.correction.state(frame_id)
        return self.filter in ("all", state) or (self.filter == "unfinished" and state in UNFINISHED)

    def first(self) -> list[str]:
        """Return the frames in the order in which to try to open one: those that wait, then the others.

        Raises CloudError for an empty set.
        """
        if not self.all_ids:
            raise CloudError(f"{self.correction.labels.path} holds no frames; label a recording first")
        return sorted(self.frame_ids, key=lambda i: not self.waits(i))

    def read(self, frame_id: str) -> FrameScene:
        """A frame's scene with its labels as they stand, waited for where it is not there yet.

        It is read anew next time where reading fails. Any thread may call this. Raises CloudError.
        """
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
        """Number of a frame's entries in the journal: while it is the same, so are the frame's labels."""
        return len(self.correction.journal.strokes(frame_id))

    def before(self, frame_id: str) -> str | None:
        """The frame before in time."""
        at = self.all_ids.index(frame_id)
        return self.all_ids[at - 1] if at else None

    def parts_before(self, frame_id: str) -> UInt8 | None:
        """Parts (h, w) of the frame before in time, as they stand; any thread may call this."""
        before = self.before(frame_id)
        try:
            if before in self._scenes and self._scenes[before][1].done():
                return self.read(before).labels.parts
            return self.correction.frame(before).parts if before else None
        except CloudError:
            return None

    def begin(self, scene: FrameScene, before: UInt8 | None) -> Opened:
        """Begin to edit a frame as it was just read, and to read those that will be needed next.

        Frames edited before stay open: ``Correction.leave_others``. Raises CloudError.
        """
        frame_id = scene.labels.frame_id
        editor = None if self.correction.read_only else self.correction.begin(scene.labels)
        if frame_id not in self.frame_ids:
            self.arrange(self.order, self.filter, frame_id)
        at = self.frame_ids.index(frame_id)
        ahead = [self.next_unfinished(frame_id), *self.frame_ids[max(0, at - 1) : at + 3], frame_id]
        self._want(i for i in ahead if i)
        return Opened(scene, editor, before)

    def beside(self, frame_id: str, by: int) -> str | None:
        """The frame ``by`` places on in the order, or None."""
        at = self.frame_ids.index(frame_id) + by
        return self.frame_ids[at] if 0 <= at < len(self.frame_ids) else None

    def next_unfinished(self, frame_id: str) -> str | None:
        """The next frame in the order that waits for this person, after the last one the first; or None."""
        at = self.frame_ids.index(frame_id) + 1
        return next((i for i in (*self.frame_ids[at:], *self.frame_ids[:at]) if self.waits(i)), None)

    def waits(self, frame_id: str) -> bool:
        """Return whether a frame waits for this person: unfinished; in the order for review, unreviewed."""
        if self.order == "review":
            return is_queued(self.correction, frame_id)
        return self.correction.state(frame_id) in UNFINISHED

    def all_done(self) -> str:
        """Return a sentence on the frames left when no shown frame waits."""
        if self.order == "review":
            return "Nothing is left to review"
        left = any(self.waits(i) for i in self.all_ids)
        return "No unfinished frame among those shown" if left else "No unfinished frames left"

    def forget(self) -> None:
        """Read every frame anew: labels have changed beside the window."""
        self._scenes.clear()
        self._confidence.clear()

    def progress(self) -> Progress:
        """Progress of the work on the whole set."""
        return progress(self.correction, self.all_ids)

    def confidence(self, frame_id: str) -> float | None:
        """Mean confidence of a frame's labels; -1 where its notes cannot be read, None where unknown."""
        if frame_id not in self._confidence:
            self._confidence[frame_id] = confidence_of(self.correction, frame_id)
        return self._confidence[frame_id]

    def close(self) -> None:
        """Stop reading ahead."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _want(self, frame_ids: Iterable[str]) -> None:
        """Begin to read frames that will be needed, and forget those that were needed longest ago."""
        for frame_id in frame_ids:
            known = self._scenes.pop(frame_id, None)
            entries = self._entries(frame_id)
            self._scenes[frame_id] = known or (entries, self._pool.submit(self._read, frame_id))
        for frame_id in list(self._scenes)[:-SCENES_KEPT]:
            self._scenes.pop(frame_id)[1].cancel()
