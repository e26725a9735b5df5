"""Live pipeline: threads that take turns fuse and label the newest moment of a rig.

Nothing queues up: a thread that is free takes the newest moment and makes it a labelled frame without a
pause. So a frame shown is never older than one labelling, and the moment for which it waited.
"""

import threading
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.label_recording import calibrated, labels_of
from annotate.live.drift_watch import DriftWatch
from annotate.live.frame_warnings import color_warning, person_warnings
from annotate.live.live_frame import BodyPose, Labelling, LiveFrame, Rig
from annotate.live.rig_warnings import rig_warnings
from annotate.live.shift_watch import ShiftWatch
from annotate.live.warning import ActiveWarnings, LiveWarning
from annotate.person.extract import PersonMask
from annotate.segmentation.segmented_person import Segmentation
from sensors.errors import CloudError, FormatError
from sensors.recording.frame_assembly import SyncedFrame
from sensors.recording.latest_value import LatestValue
from sensors.rig.frame import RigFrame

WAIT_S = 0.1
"""Seconds after which a waiting thread checks whether it is to end. Untuned."""
WORKERS = 2
"""Frames labelled at once, each by one thread from its images to its labels. Chosen for two cores."""
MOST_APART_S = 0.5
"""Most seconds from the beginning of one frame to that of the next where there are moments. Untuned:
the first frames take long, since kernels and networks are loaded."""
LATENCIES = 1000
"""Frames whose latencies are kept. Untuned: half a minute."""


@dataclass(frozen=True)
class _Fused:
    """A fused moment. left_out: notes on what its cloud lacks; unreadable: what could not be read, or ""."""

    synced: SyncedFrame
    cloud: ThermalCloud
    left_out: list[str]
    unreadable: str = ""


class LivePipeline:
    """Labelled frames of a rig that has started, from ``start`` to ``close``.

    frames: the newest one, for any number of readers. latencies_ms: of the last frames. said: every complaint
    that has stood so far, by kind. complaints: those that stand now. error: what ended it.
    The rig is the caller's to close.
    """

    def __init__(self, rig: Rig, labelling: Labelling) -> None:
        self.rig, self.frames = rig, LatestValue[LiveFrame](keep=WORKERS)
        self.latencies_ms = deque[float](maxlen=LATENCIES)
        self.warnings: tuple[LiveWarning, ...] = ()
        self.said: dict[str, str] = {}
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
        """Begin to label."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End the threads; idempotent."""
        self._stop.set()
        for thread in self._threads:
            if thread.is_alive():
                thread.join()

    # The threads

    def _work(self) -> None:
        try:
            while not self._stop.is_set():
                taken = self._take()
                if taken is not None:
                    begun_s = time.monotonic()
                    self._label(self._fused(*taken))
                    self._each_s = time.monotonic() - begun_s
                elif self.rig.frames.ended:
                    break
        except Exception as error:  # the reader raises it: here it would die with the thread
            self.error = self.error or error
            self._stop.set()
        finally:
            with self._showing:
                self._working -= 1
                if not self._working:
                    self.frames.end()

    def _take(self) -> tuple[SyncedFrame, RigFrame, list[str]] | None:
        """The newest moment that nobody has taken, its frame and notes on what is left out of it.

        Frames begin evenly spaced, so that they are shown evenly. None when there is none for some time.
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
            self._stand(rig_warnings(self.rig.health()))
        return None

    def _fused(self, synced: SyncedFrame, frame: RigFrame, left_out: list[str]) -> _Fused:
        try:
            return _Fused(synced, self._fuser.fuse_frame(frame), left_out)
        except FormatError as error:
            # A colour image that was cut off on its way.
            cloud = self._fuser.fuse_frame(replace(frame, color_encoded=None))
            return _Fused(synced, cloud, left_out, str(error))

    def _label(self, fused: _Fused) -> None:
        """Label a frame, by the labels shown last, and show it; where it fails, say why."""
        synced, cloud = fused.synced, fused.cloud
        try:
            result, person = self._labelling.label(cloud, self._before)
        except CloudError as error:
            with self._showing:
                self._before = None
                self._stand([*rig_warnings(self.rig.health()), LiveWarning("frame", str(error))])
            return
        labels = labels_of(f"{synced.frame.index:06d}", cloud.depth_mm, result, person, fused.left_out)
        body_pose = self._labelling.body_pose(labels, cloud.camera)
        with self._showing:
            if synced.arrival_ns >= self._shown_ns:
                self._show(fused, labels, body_pose, person, result)

    def _show(
        self,
        fused: _Fused,
        labels: FrameLabels,
        body_pose: BodyPose | None,
        person: PersonMask,
        result: Segmentation,
    ) -> None:
        synced, cloud, health = fused.synced, fused.cloud, self.rig.health()
        self._stand([*rig_warnings(health), *self._of_frame(fused, person, result)])
        self._before, self._shown_ns = labels, synced.arrival_ns
        latency_ms = (time.monotonic_ns() - synced.arrival_ns) * 1e-6
        self.latencies_ms.append(latency_ms)
        self.frames.put(LiveFrame(synced, cloud, labels, body_pose, health, self.warnings, latency_ms))

    def _stand(self, made: Iterable[LiveWarning]) -> None:
        """Take the complaints of a moment: of a rig that gives no images, too."""
        self.warnings = self._active.update(made, time.monotonic())
        self.said |= {warning.kind: warning.text for warning in self.warnings}

    def _of_frame(self, fused: _Fused, person: PersonMask, result: Segmentation) -> list[LiveWarning]:
        cloud = fused.cloud
        made = list(person_warnings(cloud, person.mask))
        if fused.unreadable:
            made.append(LiveWarning("frame", fused.unreadable))
        lit = not {"dark", "glare"} & {warning.kind for warning in made}
        if lit and result.illuminant is not None:
            made += filter(None, [color_warning(cloud, person.mask, result.illuminant)])
        made += filter(None, [self._shift.warning(cloud, person.mask, fused.synced.arrival_ns)])
        return made

    def latency_ms(self, share: float) -> float:
        """Milliseconds within which this share of the last frames was labelled; NaN before the first."""
        latencies = list(self.latencies_ms)
        return float(np.quantile(latencies, share)) if latencies else float("nan")
