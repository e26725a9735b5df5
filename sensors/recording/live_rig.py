"""Running rig: it returns its latest synchronised frame, and writes every reading to disk while it
records.
"""

import gc
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from sensors.device.protocol import Device
from sensors.errors import CalibrationError, CloudError, ExistsError, one_line
from sensors.recording.arrival_times import Arrived, Event
from sensors.recording.device_readers import Intake
from sensors.recording.frame_assembly import FrameAssembly, SyncedFrame
from sensors.recording.image_check import ImageCheck
from sensors.recording.latest_value import LatestValue
from sensors.recording.recorder import DISK_S, RESERVE_BYTES, Recorder, Take, clock_metadata
from sensors.recording.stream_health import FAULT_NS, Health, Watch
from sensors.rig.rig_calibration import RigCalibration

EVENTS_KEPT = 100
SETUP_S = 10.0  # s after the start in which a camera in a wrong mode ends the rig; untuned
T = TypeVar("T")
_freezing = set["LiveRig"]()  # running rigs: see ``LiveRig.start``


class LiveRig:
    """Rig of started devices, read by one thread from ``start`` to ``close``.

    Only that thread writes, because signals do not interrupt it. reopen: function that opens and starts a
    lost device. frames: queue of the latest frame, which ends with the rig. events: the last events with
    running numbers. error: reason of the rig's end. Raises DeviceError if two devices have one stream, or
    depth is missing.
    """

    def __init__(
        self,
        name: str,
        devices: Sequence[Device],
        calibration: RigCalibration,
        latency_ms: Mapping[str, float],
        reopen: Callable[[str], Device],
    ) -> None:
        rates_hz = {stream: hz for device in devices for stream, hz in device.rates_hz.items()}
        self.name, self.calibration = name, calibration
        self.frames = LatestValue[SyncedFrame]()
        self.events = deque[tuple[int, Event]](maxlen=EVENTS_KEPT)
        self.error: Exception | None = None
        self._intake = Intake(devices, reopen)
        self._watch = Watch(devices, {address: round(ms * 1e6) for address, ms in latency_ms.items()})
        self._pairing = FrameAssembly(rates_hz)
        self._recorder = Recorder(name, calibration, clock_metadata(devices, latency_ms))
        self._check, self._left_out = ImageCheck(calibration), dict[str, Event]()
        self._counting, self._queueing = threading.Lock(), threading.Lock()
        self._actions: deque[Callable[[], None]] = deque()
        self._serving = False
        self._started_s = 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="rig", daemon=True)

    def start(self) -> None:
        """Begin to read; existing objects are excluded from garbage collection.

        A full collection stops every thread for 60 to 120 ms, and a thermal camera buffers 125 ms of images.
        """
        self._started_s, self._serving = time.monotonic(), True
        _freezing.add(self)
        gc.freeze()
        self._thread.start()

    def close(self) -> None:
        """End the recording and the thread, and release the devices; idempotent."""
        self._stop.set()
        self._intake.wake()
        if self._thread.ident is None:
            self._intake.__exit__()
            self._recorder.end()
        else:
            self._thread.join()
        if _freezing:
            _freezing.discard(self)
            if not _freezing:
                gc.unfreeze()

    def record(self, path: Path, subject: str = "", overwrite: bool = False, infrared: bool = False) -> None:
        """Write every reading from now on into a session.

        subject: name of the person, "" if unknown. infrared: keep infrared images, for ``calibrate``. Raises
        ExistsError, and CloudError during another recording or after the rig's end.
        """

        def begin() -> None:
            if self.frames.ended:
                why = self.error or "closed"
                raise CloudError(
                    f"{self.name} has stopped, there is nothing to record ({why}); start the command again"
                )
            self._recorder.begin(path, subject, overwrite, infrared)

        self._in_thread(begin)
        # Kernels, networks and the window were loaded since the start.
        if self in _freezing:
            gc.freeze()

    def end_recording(self) -> Path | None:
        """End the recording, if there is one, and return the path of its session.

        Raises OSError, and ExistsError if another program made a file of its name meanwhile.
        """
        return self._in_thread(self._end_recording)

    def mark(self, text: str) -> None:
        """Add an event, also to the recording if there is one."""
        self._in_thread(lambda: self._keep(Event(self._intake.now_ns(), one_line(text))))

    @property
    def last_take(self) -> Take | None:
        """Return the current recording, or else the last one."""
        return self._recorder.last

    def _end_recording(self) -> Path | None:
        self._take_in()
        return self._recorder.end()

    def health(self) -> Health:
        """Return the state of the rig."""
        now_ns, watch, away = self._intake.now_ns(), self._watch, self._intake.away
        take, free_bytes = self._recorder.take, self._recorder.free_bytes
        with self._counting:
            streams, skew, bytes_per_s = watch.streams(now_ns, away), watch.skew_ppm(), watch.bytes_per_s()
        left_s = max(0, free_bytes - RESERVE_BYTES) / bytes_per_s if bytes_per_s else float("inf")
        return Health(
            streams,
            tuple(sorted(away)),
            watch.flag_closed_s(now_ns),
            skew,
            take.writer.path if take else None,
            take.seconds if take else 0.0,
            left_s / 60 if free_bytes else float("inf"),
            self._recorder.trouble,
            tuple(
                fault.text
                for fault in [*self._intake.faults.values(), *self._left_out.values()]
                if now_ns - fault.stamp_ns < FAULT_NS
            ),
        )

    def _in_thread(self, action: Callable[[], T]) -> T:
        """Return the result of an action, run in the rig's thread if there is one, else in the caller's."""
        future = Future[T]()

        def act() -> None:
            try:
                future.set_result(action())
            except BaseException as error:  # raised again in the caller
                future.set_exception(error)

        with self._queueing:
            if queued := self._serving:
                self._actions.append(act)
        if queued:
            self._intake.wake()
        else:
            act()
        return future.result()

    def _run(self) -> None:
        try:
            with self._intake:
                self._serve()
            self._take_in()
        except Exception as error:  # raised by the user of the rig, not in this thread
            self.error = error
            if isinstance(error, CalibrationError):
                self._discard()
        finally:
            with suppress(OSError, ExistsError):
                self._recorder.end()
            self.frames.end()
            with self._queueing:
                self._serving = False
            self._run_actions()

    def _discard(self) -> None:
        """Remove the recording, because a camera was in a wrong mode from the start."""
        take = self._recorder.take
        self._recorder.abandon()
        if take is not None:
            take.writer.partial.unlink(missing_ok=True)

    def _serve(self) -> None:
        checked_s = time.monotonic()
        while not self._stop.is_set():
            self._run_actions()
            self._take_in()
            if (frame := self._pairing.latest(self._intake.now_ns())) is not None:
                self.frames.put(frame)
            if time.monotonic() - checked_s >= DISK_S:
                checked_s = time.monotonic()
                self._recorder.check_disk(self._intake.now_ns())
            self._intake.wait(0.02)

    def _run_actions(self) -> None:
        while self._actions:
            self._actions.popleft()()

    def _take_in(self) -> None:
        """Check, count, pair and write all readings that have arrived."""
        for item in self._intake.drain():
            self._keep(item)

    def _keep(self, item: Arrived | Event) -> None:
        if isinstance(item, Event):
            with self._counting:
                number = self.events[-1][0] + 1 if self.events else 1
                self.events.append((number, item))
            self._recorder.write(item)
            return
        fault = self._fault(item) if item.usable else ""
        with self._counting:
            host_ns = self._watch.add(item, left_out=bool(fault))
        if fault:
            event = Event(item.stamp_ns, fault, item.arrival_ns)
            self._left_out[item.reading.stream] = event
            self._keep(event)
        else:
            self._pairing.add(item, host_ns)
            self._recorder.write(item)

    def _fault(self, item: Arrived) -> str:
        try:
            return self._check.fault(item.reading.value)
        except CalibrationError as error:
            if time.monotonic() - self._started_s < SETUP_S:
                raise
            return str(error)
