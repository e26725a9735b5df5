"""The frames of a set in order: the next one, the previous one, and reading ahead. No window here."""

from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor

from annotate.correction.correction import Correction, RestorableError
from annotate.correction.edit import Editor
from annotate.correction.propagate import FRAMES_COMPARED
from annotate.gui.scene import FrameScene, SceneReader
from sensors.errors import CloudError

SCENES_KEPT = 6
"""Number of scenes in memory: the one shown, those around it, and the one before. Chosen by eye."""
Opened = tuple[FrameScene, Editor | None]
"""A frame for the desk; without an editor where the set is open read-only."""


class Walk:
    """The frames of one set. ask_restore: returns whether to rebuild a broken frame, given the error.

    worst_first: the order, else by time. frame_ids: in this order.
    """

    def __init__(
        self, correction: Correction, reader: SceneReader, ask_restore: Callable[[str], bool]
    ) -> None:
        self.correction, self._ask_restore = correction, ask_restore
        self._read, self._pool = reader.read, ThreadPoolExecutor(1, "prefetch")
        self._scenes: dict[str, Future[FrameScene]] = {}
        self.worst_first = False
        self.frame_ids = correction.labels.frame_ids
        self._others_done = 0

    def reorder(self) -> None:
        """Switch to the other order."""
        self.worst_first = not self.worst_first
        self.frame_ids = self.correction.labels.frame_ids
        if self.worst_first:
            self.frame_ids.sort(key=self._confidence)

    def first(self) -> Opened:
        """The first frame that nobody has finished, or else the first that can be read.

        Raises what reading the first one raised when none can, CloudError for an empty set.
        """
        error: CloudError | None = None
        for frame_id in sorted(self.frame_ids, key=self._is_done):
            try:
                return self.open(frame_id)
            except CloudError as reason:
                error = error or reason
        raise error or CloudError(f"{self.correction.labels.path} holds no frames; label a recording first")

    def open(self, frame_id: str) -> Opened:
        """A frame, its broken files restored where the user agrees. Raises CloudError."""
        scene = self._scene(frame_id)
        editor = None if self.correction.read_only else self.correction.edit(frame_id)
        at = self.frame_ids.index(frame_id)
        self._want([*self.frame_ids[max(0, at - 1) : at + 3], frame_id])
        self._others_done = sum(self._is_done(i) for i in self.frame_ids if i != frame_id)
        return scene, editor

    def done(self, frame_id: str) -> int:
        """Number of finished frames while this one is open: only its own state can change."""
        return self._others_done + self._is_done(frame_id)

    def beside(self, frame_id: str, by: int) -> str | None:
        """The frame ``by`` places on in the order, or None."""
        at = self.frame_ids.index(frame_id) + by
        return self.frame_ids[at] if 0 <= at < len(self.frame_ids) else None

    def before(self, frame_id: str) -> str:
        """The frame before in time. Raises CloudError for the first."""
        frame_ids = self.correction.labels.frame_ids
        at = frame_ids.index(frame_id)
        if not at:
            raise CloudError("This is the first frame; there is none before it")
        return frame_ids[at - 1]

    def corrected_near(self, frame_id: str) -> list[str]:
        """Ids of the frames nearest in time, before and after, that people corrected or accepted.

        Raises CloudError where there are none.
        """
        frame_ids = self.correction.labels.frame_ids
        at = frame_ids.index(frame_id)
        near = sorted(range(len(frame_ids)), key=lambda i: (abs(i - at), i))
        done = [frame_ids[i] for i in near if self.correction.state(frame_ids[i]) not in ("auto", "rejected")]
        if not (found := [i for i in done if i != frame_id][:FRAMES_COMPARED]):
            raise CloudError("No frame has been corrected yet: there is nothing to carry over")
        return found

    def close(self) -> None:
        """Stop reading ahead."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _scene(self, frame_id: str) -> FrameScene:
        try:
            return self._take(frame_id)
        except RestorableError as error:
            if self.correction.read_only or not self._ask_restore(str(error)):
                raise
            self.correction.restore(frame_id)
            return self._take(frame_id)

    def _want(self, frame_ids: Iterable[str]) -> None:
        """Begin to read frames that will be needed, and forget those that were needed longest ago."""
        for frame_id in frame_ids:
            known = self._scenes.pop(frame_id, None)
            self._scenes[frame_id] = known or self._pool.submit(self._read, frame_id)
        for frame_id in list(self._scenes)[:-SCENES_KEPT]:
            self._scenes.pop(frame_id).cancel()

    def _take(self, frame_id: str) -> FrameScene:
        """A frame's scene, waited for where it is not there yet; read anew next time where reading fails."""
        self._want([frame_id])
        try:
            return self._scenes[frame_id].result()
        except BaseException:
            del self._scenes[frame_id]
            raise

    def _is_done(self, frame_id: str) -> bool:
        return self.correction.state(frame_id) not in ("auto", "touched")

    def _confidence(self, frame_id: str) -> float:
        """A frame's confidence from its notes; unreadable frames sort first, frames without one last."""
        try:
            value = self.correction.labels.notes(frame_id).get("confidence")
        except CloudError:
            return -1.0
        return float(value) if isinstance(value, int | float) else 2.0
