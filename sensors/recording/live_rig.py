"""A running rig: its newest moment to look at, and every reading on the disk while it is recorded."""

import gc
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from sensors.device.protocol import Device
from sensors.errors import CloudError, one_line
from sensors.recording.health import FAULT_NS, Health, Watch
from sensors.recording.intake import Arrived, Event, Intake
from sensors.recording.moments import Moment, Moments
from sensors.recording.newest import Newest
from sensors.recording.recorder import DISK_FULL, LOOK_S, RESERVE_BYTES, clock_metadata, write_item
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.messages import SUBJECT
from sensors.session.writer import SessionWriter

EVENTS_KEPT = 100
"""Number of events that are kept. Chosen by eye."""


@dataclass(frozen=True)
class Take:
    """A recording under way. started_s: on ``time.monotonic``."""

    writer: SessionWriter
    started_s: float


class LiveRig:
    """Devices that have started, run by a thread of their own from ``start`` to ``close``.

    name, calibration: the rig's. reopen: opens and starts a device that was lost. moments: the newest moment,
    which ends with the rig. events: the last that happened, with running numbers. error: what ended the rig.
    Raises DeviceError where two devices have one stream, or none gives depth.
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
        self.moments = Newest[Moment]()
        self.events = deque[tuple[int, Event]](maxlen=EVENTS_KEPT)
        self.error: Exception | None = None
        self._metadata = clock_metadata(devices, latency_ms)
        self._intake = Intake(devices, reopen)
        self._watch = Watch(rates_hz, {address: round(ms * 1e6) for address, ms in latency_ms.items()})
        self._pairing = Moments(rates_hz)
        self._writing = threading.Lock()
        self._take: Take | None = None
        self._folder, self._free_bytes = Path.cwd(), 0
        self._trouble = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="rig", daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def close(self) -> None:
        """End the recording and the thread, and give the devices back; idempotent."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        elif self._thread.ident is None:
            self._intake.__exit__()
        self.end_recording()

    # Recording

    def record(self, path: Path, subject: str = "", overwrite: bool = False) -> None:
        """Write every reading from now on into a session. subject: the name of the person, "" if unknown.

        Raises ExistsError, and CloudError while another recording goes on or after the rig has ended.
        """
        if self.moments.ended:
            raise CloudError(f"{self.name} has stopped, there is nothing to record: {self.error or 'closed'}")
        if self._take is not None:
            raise CloudError(f"{self._take.writer.path} is being recorded; end that recording first")
        metadata = self._metadata | ({SUBJECT: subject} if subject else {})
        writer = SessionWriter(path, self.calibration, self.name, overwrite=overwrite, metadata=metadata)
        writer.__enter__()
        # Over what has been loaded since, too (see ``Intake``): kernels, networks, the window.
        gc.freeze()
        self._folder, self._trouble = path.parent, ""
        with self._writing:
            self._take = Take(writer, time.monotonic())

    def end_recording(self) -> Path | None:
        """End the recording, if there is one; its session, whole and on the disk. Raises OSError."""
        with self._writing:
            take, self._take = self._take, None
        if take is None:
            return None
        try:
            take.writer.__exit__(None)
        except OSError as error:
            self._trouble = _cut_off(take, error)
            raise
        return take.writer.path

    def mark(self, text: str) -> None:
        """Note an event, in the recording too if there is one."""
        self._keep(Event(self._intake.now_ns(), one_line(text)))

    # Looking

    def health(self) -> Health:
        """The rig as it is now."""
        now_ns, take, watch = self._intake.now_ns(), self._take, self._watch
        with self._writing:
            streams, skew, bytes_per_s = watch.streams(now_ns), watch.skew_ppm(), watch.bytes_per_s()
        left_s = max(0, self._free_bytes - RESERVE_BYTES) / bytes_per_s if bytes_per_s else float("inf")
        return Health(
            streams,
            tuple(sorted(self._intake.away)),
            watch.flag_closed_s(now_ns),
            skew,
            watch.running_s(now_ns),
            take.writer.path if take else None,
            time.monotonic() - take.started_s if take else 0.0,
            left_s / 60 if self._free_bytes else float("inf"),
            self._trouble,
            tuple(
                fault.text
                for fault in list(self._intake.faults.values())
                if now_ns - fault.stamp_ns < FAULT_NS
            ),
        )

    # The thread

    def _run(self) -> None:
        looked_s = 0.0
        try:
            with self._intake:
                while not self._stop.is_set():
                    self._turn()
                    if time.monotonic() - looked_s >= LOOK_S:
                        looked_s = time.monotonic()
                        self._look_at_disk()
                    self._intake.wait(0.02)
            self._turn()
        except Exception as error:  # the reader raises it: here it would die with the thread
            self.error = error
            with suppress(OSError):
                self.end_recording()
        finally:
            self.moments.end()

    def _turn(self) -> None:
        """All that has come: kept, counted and paired."""
        for item in self._intake.drain():
            self._keep(item)
        moment = self._pairing.newest(self._intake.now_ns())
        if moment is not None:
            moment.frame.sized_as(self.calibration)
            self.moments.put(moment)

    def _keep(self, item: Arrived | Event) -> None:
        with self._writing:
            if isinstance(item, Event):
                number = self.events[-1][0] + 1 if self.events else 1
                self.events.append((number, item))
            else:
                self._pairing.add(item, self._watch.add(item))
            if self._take is None:
                return
            try:
                write_item(self._take.writer, item)
            except OSError as error:
                self._abandon(error)

    def _look_at_disk(self) -> None:
        with suppress(OSError):
            self._free_bytes = shutil.disk_usage(self._folder).free
        if self._take is not None and self._free_bytes < RESERVE_BYTES:
            self._keep(Event(self._intake.now_ns(), DISK_FULL))
            with suppress(OSError):
                self.end_recording()
            self._trouble = self._trouble or DISK_FULL

    def _abandon(self, error: OSError) -> None:
        """End a recording that the disk refuses; what was written stays, as a session that was cut off."""
        take, self._take = self._take, None
        if take is not None:
            with suppress(OSError):
                take.writer.__exit__(OSError)
            self._trouble = _cut_off(take, error)


def _cut_off(take: Take, error: OSError) -> str:
    """What to say of a recording that the disk refuses."""
    why = error.strerror or error
    return f"the recording ended: {why}; {take.writer.partial} holds what came before: repair it"
