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
from annotate.live.frame_warnings import color_complaint, person_complaints
from annotate.live.live_frame import Labelling, LiveFrame, Rig, Stance
from annotate.live.rig_warnings import rig_complaints
from annotate.live.shift_watch import ShiftWatch
from annotate.live.warning import Complaint, Standing
from annotate.person.extract import PersonMask
from annotate.segmentation.segmented_person import Segmentation
from sensors.errors import CloudError, FormatError
from sensors.recording.frame_assembly import Moment
from sensors.recording.latest_value import Newest
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

    moment: Moment
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
        self.rig, self.frames = rig, Newest[LiveFrame](keep=WORKERS)
        self.latencies_ms = deque[float](maxlen=LATENCIES)
        self.complaints: tuple[Complaint, ...] = ()
        self.said: dict[str, str] = {}
        self.error: Exception | None = None
        self._labelling, self._fuser = labelling, Fuser(rig.calibration)
        self._taking, self._showing = threading.Lock(), threading.Lock()
        self._taken, self._next_s, self._each_s = 0, 0.0, 0.0
        self._before: FrameLabels | None = None
        self._shown_ns = 0
        self._stop = threading.Event()
        self._standing, self._shift = Standing(), ShiftWatch()
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
                elif self.rig.moments.ended:
                    break
        except Exception as error:  # the reader raises it: here it would die with the thread
            self.error = self.error or error
            self._stop.set()
        finally:
            with self._showing:
                self._working -= 1
                if not self._working:
                    self.frames.end()

    def _take(self) -> tuple[Moment, RigFrame, list[str]] | None:
        """The newest moment that nobody has taken, its frame and notes on what is left out of it.

        Frames begin evenly spaced, so that they are shown evenly. None when there is none for some time.
        """
        with self._taking:
            self._stop.wait(max(0.0, self._next_s - time.monotonic()))
            newest = self.rig.moments.after(self._taken, WAIT_S)
            if newest is not None:
                self._taken, moment = newest
                self._next_s = time.monotonic() + min(self._each_s / WORKERS, MOST_APART_S)
                frame, left_out = calibrated(moment.frame, self._fuser.calibration)
                return moment, self._drift.corrected(moment, frame), left_out
        with self._showing:
            self._stand(rig_complaints(self.rig.health()))
        return None

    def _fused(self, moment: Moment, frame: RigFrame, left_out: list[str]) -> _Fused:
        try:
            return _Fused(moment, self._fuser.fuse_frame(frame), left_out)
        except FormatError as error:
            # A colour image that was cut off on its way.
            cloud = self._fuser.fuse_frame(replace(frame, color_encoded=None))
            return _Fused(moment, cloud, left_out, str(error))

    def _label(self, fused: _Fused) -> None:
        """Label a frame, by the labels shown last, and show it; where it fails, say why."""
        moment, cloud = fused.moment, fused.cloud
        try:
            result, person = self._labelling.label(self._labelling.survey(cloud), self._before)
        except CloudError as error:
            with self._showing:
                self._before = None
                self._stand([*rig_complaints(self.rig.health()), Complaint("frame", str(error))])
            return
        labels = labels_of(f"{moment.frame.index:06d}", cloud.depth_mm, result, person, fused.left_out)
        stance = self._labelling.stance(labels, cloud.camera)
        with self._showing:
            if moment.arrival_ns >= self._shown_ns:
                self._show(fused, labels, stance, person, result)

    def _show(
        self,
        fused: _Fused,
        labels: FrameLabels,
        stance: Stance | None,
        person: PersonMask,
        result: Segmentation,
    ) -> None:
        moment, cloud, health = fused.moment, fused.cloud, self.rig.health()
        self._stand([*rig_complaints(health), *self._of_frame(fused, person, result)])
        self._before, self._shown_ns = labels, moment.arrival_ns
        latency_ms = (time.monotonic_ns() - moment.arrival_ns) * 1e-6
        self.latencies_ms.append(latency_ms)
        self.frames.put(LiveFrame(moment, cloud, labels, stance, health, self.complaints, latency_ms))

    def _stand(self, made: Iterable[Complaint]) -> None:
        """Take the complaints of a moment: of a rig that gives no images, too."""
        self.complaints = self._standing.update(made, time.monotonic())
        self.said |= {complaint.kind: complaint.text for complaint in self.complaints}

    def _of_frame(self, fused: _Fused, person: PersonMask, result: Segmentation) -> list[Complaint]:
        cloud = fused.cloud
        made = list(person_complaints(cloud, person.mask))
        if fused.unreadable:
            made.append(Complaint("frame", fused.unreadable))
        lit = not {"dark", "glare"} & {complaint.kind for complaint in made}
        if lit and result.light is not None:
            made += filter(None, [color_complaint(cloud, person.mask, result.light)])
        made += filter(None, [self._shift.complaint(cloud, person.mask, fused.moment.arrival_ns)])
        return made

    def latency_ms(self, share: float) -> float:
        """Milliseconds within which this share of the last frames was labelled; NaN before the first."""
        latencies = list(self.latencies_ms)
        return float(np.quantile(latencies, share)) if latencies else float("nan")
