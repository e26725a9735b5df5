"""Reads the frames ahead in a thread, so that the next one opens at once."""

from collections import OrderedDict
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor

from annotate.gui.scene import FrameScene

SCENES_KEPT = 6
"""Number of scenes in memory: the one shown, those around it, and the one before. Chosen by eye."""


class Prefetch:
    """Scenes by frame id, the latest SCENES_KEPT of them."""

    def __init__(self, read: Callable[[str], FrameScene]) -> None:
        self._read = read
        self._pool = ThreadPoolExecutor(1, "prefetch")
        self._scenes: OrderedDict[str, Future[FrameScene]] = OrderedDict()

    def want(self, frame_ids: Iterable[str]) -> None:
        """Begin to read frames that will be needed."""
        for frame_id in frame_ids:
            if frame_id in self._scenes:
                self._scenes.move_to_end(frame_id)
            else:
                self._scenes[frame_id] = self._pool.submit(self._read, frame_id)
        while len(self._scenes) > SCENES_KEPT:
            self._scenes.popitem(last=False)[1].cancel()

    def take(self, frame_id: str) -> FrameScene:
        """A frame's scene, waiting where it is not there yet. Raises what reading it raises."""
        self.want([frame_id])
        try:
            return self._scenes[frame_id].result()
        except BaseException:
            self.forget(frame_id)
            raise

    def forget(self, frame_id: str) -> None:
        """Read a frame anew when it is wanted next: it was changed on the disk."""
        self._scenes.pop(frame_id, None)

    def close(self) -> None:
        """Stop the thread."""
        self._pool.shutdown(wait=True, cancel_futures=True)
