"""Live pipeline: threads that take turns to fuse and label the latest frame of a rig.

Frames are not queued: a free thread takes the latest frame. So a displayed frame lags behind the rig by one
labelling and one frame period at most.
"""

import threading
import time
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from annotate.array_types import Bool
from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.label_recording import calibrated
from annotate.live.drift_watch import DriftWatch
from annotate.live.frame_warnings import ShiftWatch, color_warning, person_warnings
from annotate.live.live_frame import Labelling, LiveFrame, Rig
from annotate.live.rig_warnings import rig_warnings
from annotate.live.warning import ActiveWarnings, LiveWarning
from annotate.segmentation.labels_of_frame import labels_of
from annotate.suit.color_model import ColorModel
from sensors.errors import CloudError, FormatError
from sensors.recording.frame_assembly import SyncedFrame
from sensors.recording.latest_value import LatestValue
from sensors.recording.stream_health import Health
from sensors.rig.frame import RigFrame

WAIT_S = 0.1  # s; longest wait before a thread checks for the end; untuned
WORKERS = 2  # frames labelled at once, each by one thread; for two cores
# S; most between the starts of two frames, as the first ones load kernels and networks; untuned.
MOST_APART_S = 0.5
LATENCIES = 1000  # frames whose latencies are kept: half a minute; untuned


@dataclass(frozen=True)
class _Fused:
    """Fused frame. left_out: notes on missing parts of the cloud. unreadable: fault of its colour image or
    "".
    """

    synced: SyncedFrame
    cloud: ThermalCloud
    left_out: list[str]
    unreadable: str = ""


class LivePipeline:
    """Pipeline that labels a started rig's frames, from ``start`` to ``close``. The caller closes the rig.

    frames: queue of the latest labelled frames, for any number of readers. latencies_ms: of the last frames.
    warned: latest text of each kind of warning so far. warnings: active ones. error: error that ended a
    thread, or None.
    """

    def __init__(self, rig: Rig, labelling: Labelling) -> None:
        self.rig, self.frames = rig, LatestValue[LiveFrame](keep=WORKERS)
        self.latencies_ms = deque[float](maxlen=LATENCIES)
        self.warnings: tuple[LiveWarning, ...] = ()
        self.warned: dict[str, str] = {}
        self.error: Exception | None = None
        self._labelling, self._fuser = labelling, Fuser(rig.calibration)
        self._taking, self._showing = threading.Lock(), threading.Lock()
        self._taken, self._next_s, self._each_s = 0, 0.0, 0.0
        self._before: FrameLabels | None = None
        self._shown_ns = 0
        self._stop = threading.Event()
        self._active, self._shift = ActiveWarnings(), ShiftWatch()
        self._drift = DriftWatch(rig.calibration)
        self._threads = [
            threading.Thread(target=self._work, name=f"label {i}", daemon=True) for i in range(WORKERS)
        ]
        self._working = len(self._threads)

    def start(self) -> None:
        """Start the threads."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End the threads; idempotent."""
        self._stop.set()
        for thread in self._threads:
            if thread.is_alive():
                thread.join()

    def _work(self) -> None:
        """Label frames until the pipeline is closed or the rig ends; each thread runs this."""
        try:
            while not self._stop.is_set():
                taken = self._take()
                if taken is not None:
                    begun_s = time.monotonic()
                    self._label(self._fused(*taken))
                    self._each_s = time.monotonic() - begun_s
                elif self.rig.frames.ended:
                    break
        except Exception as error:  # raised by the user of the pipeline, not in this thread
            self.error = self.error or error
            self._stop.set()
        finally:
            with self._showing:
                self._working -= 1
                if not self._working:
                    self.frames.end()

    def _take(self) -> tuple[SyncedFrame, RigFrame, list[str]] | None:
        """Return the latest frame that no thread has taken, raw and calibrated, and notes on missing parts.

        Waits first, so that frames start at even intervals and are shown evenly. Returns None if no new frame
        comes within ``WAIT_S``.
        """
        with self._taking:
            self._stop.wait(max(0.0, self._next_s - time.monotonic()))
            latest = self.rig.frames.after(self._taken, WAIT_S)
            if latest is not None:
                self._taken, synced = latest
                self._next_s = time.monotonic() + min(self._each_s / WORKERS, MOST_APART_S)
                frame, left_out = calibrated(synced.frame, self._fuser.calibration)
                return synced, self._drift.corrected(synced, frame), left_out
        with self._showing:
            self._warn()
        return None

    def _fused(self, synced: SyncedFrame, frame: RigFrame, left_out: list[str]) -> _Fused:
        try:
            return _Fused(synced, self._fuser.fuse_frame(frame), left_out)
        except FormatError as error:
            # The colour image is truncated.
            cloud = self._fuser.fuse_frame(replace(frame, color_encoded=None))
            return _Fused(synced, cloud, left_out, str(error))

    def _label(self, fused: _Fused) -> None:
        """Label a frame, given the last shown labels, and publish it; warn if labelling fails."""
        synced, cloud = fused.synced, fused.cloud
        try:
            result, person = self._labelling.label(cloud, self._before)
        except CloudError as error:
            with self._showing:
                self._before = None
                self._warn(LiveWarning("frame", str(error)))
            return
        labels = labels_of(f"{synced.frame.index:06d}", cloud.depth_mm, result, person, fused.left_out)
        body_pose = self._labelling.body_pose(labels, cloud.camera)
        with self._showing:
            if synced.arrival_ns < self._shown_ns:
                return
            health = self._warn(*self._frame_warnings(fused, person.mask, result.illuminant))
            self._before, self._shown_ns = labels, synced.arrival_ns
            latency_ms = (time.monotonic_ns() - synced.arrival_ns) * 1e-6
            self.latencies_ms.append(latency_ms)
            self.frames.put(LiveFrame(synced, cloud, labels, body_pose, health, self.warnings, latency_ms))

    def _warn(self, *of_frame: LiveWarning) -> Health:
        """Update the warnings from the rig's health and from a frame's warnings; return the health."""
        health = self.rig.health()
        self.warnings = self._active.update([*rig_warnings(health), *of_frame], time.monotonic())
        self.warned |= {warning.kind: warning.text for warning in self.warnings}
        return health

    def _frame_warnings(
        self, fused: _Fused, person: Bool, illuminant: ColorModel | None
    ) -> list[LiveWarning]:
        cloud = fused.cloud
        made = list(person_warnings(cloud, person))
        if fused.unreadable:
            made.append(LiveWarning("frame", fused.unreadable))
        lit = not {"dark", "glare"} & {warning.kind for warning in made}
        if lit and illuminant is not None:
            made += filter(None, [color_warning(cloud, person, illuminant)])
        made += filter(None, [self._shift.warning(cloud, person, fused.synced.arrival_ns)])
        return made

    def latency_ms(self, share: float) -> float:
        """Return the quantile ``share`` of the last frames' latencies, in milliseconds; NaN before any
        frame.
        """
        latencies = list(self.latencies_ms)
        return float(np.quantile(latencies, share)) if latencies else float("nan")
