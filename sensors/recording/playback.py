"""A session or another frame source, played back like a running rig."""

import threading
import time
from collections import deque
from pathlib import Path

from sensors.errors import CloudError
from sensors.recording.arrival_times import Event
from sensors.recording.frame_assembly import SyncedFrame
from sensors.recording.latest_value import LatestValue
from sensors.recording.stream_health import Health, StreamHealth
from sensors.rig.frame import FrameSource

LONGEST_S = 1.0  # s; longest pause between two frames, as longer gaps separate recordings; untuned


class Playback:
    """Source of frames played at its own pace by a thread, with the interface of a ``LiveRig``.

    events: of the session so far, with running numbers.
    """

    def __init__(self, source: FrameSource) -> None:
        self.name, self.calibration = source.name, source.calibration
        self.frames = LatestValue[SyncedFrame]()
        self.events = deque[tuple[int, Event]](maxlen=100)
        self.error: Exception | None = None
        self._source = source
        self._coming = deque(enumerate(sorted(source.events), 1))
        self._stop = threading.Event()
        self._started_s = 0.0
        self._thread = threading.Thread(target=self._run, name="playback", daemon=True)

    def start(self) -> None:
        """Begin to play."""
        self._started_s = time.monotonic()
        self._thread.start()

    def close(self) -> None:
        """End the playback; idempotent."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def record(self, path: Path, subject: str = "", overwrite: bool = False) -> None:
        """Raise CloudError, because a played source is not recorded."""
        raise CloudError(f"{self.name} is played back, which cannot be recorded to {path}; copy it instead")

    def end_recording(self) -> Path | None:
        """Return None, because nothing is recorded."""
        return None

    def mark(self, text: str) -> None:
        """Raise CloudError, because a played source takes no events."""
        raise CloudError(
            f"{self.name} is played back, so {text!r} cannot be marked; mark events while a rig records"
        )

    def health(self) -> Health:
        """Return a state that holds only the number and rate of the frames."""
        count, running_s = self.frames.count, time.monotonic() - self._started_s
        return Health({"depth": StreamHealth(0.0, count / max(running_s, 1e-9), silent_s=0.0, count=count)})

    def _run(self) -> None:
        due_s, last_ns = time.monotonic(), None
        try:
            for frame in self._source:
                if last_ns is not None:
                    due_s += min(max(0.0, (frame.stamp_ns - last_ns) * 1e-9), LONGEST_S)
                last_ns = frame.stamp_ns
                if self._stop.wait(max(0.0, due_s - time.monotonic())):
                    return
                while self._coming and self._coming[0][1][0] <= frame.stamp_ns:
                    number, (stamp_ns, text) = self._coming.popleft()
                    self.events.append((number, Event(stamp_ns, text)))
                self.frames.put(SyncedFrame(frame, frame.stamp_ns, time.monotonic_ns()))
        except Exception as error:  # raised by the reader of the frames, not in this thread
            self.error = error
        finally:
            self.frames.end()
