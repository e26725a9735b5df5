"""The newest moment of a rig fused and labelled again and again, by two threads: one surveys, one labels.

Nothing queues up: a moment that comes while both are busy is looked at only if no newer one has come when one
of them is free.
"""

import threading
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from queue import Empty, Full, Queue
from typing import Any

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.label_source import calibrated, labels_of
from annotate.live.complaint import Complaint, Standing
from annotate.live.drift_watch import DriftWatch
from annotate.live.frame_complaints import color_complaint, person_complaints
from annotate.live.live_frame import Labelling, LiveFrame, Rig
from annotate.live.rig_complaints import rig_complaints
from annotate.live.shift_watch import ShiftWatch
from annotate.person.extract import PersonMask
from annotate.segmentation.segment import Segmentation
from sensors.errors import CloudError, FormatError
from sensors.recording.moments import Moment
from sensors.recording.newest import Newest

WAIT_S = 0.1
"""Seconds after which a waiting thread checks whether it is to end. Chosen by eye."""
LATENCIES = 1000
"""Frames whose latencies are kept. Chosen by eye: half a minute."""


@dataclass(frozen=True)
class _Surveyed:
    """survey: None where nothing could be made of the frame. unreadable: why, or what was left out; or ""."""

    moment: Moment
    cloud: ThermalCloud
    survey: Any
    left_out: list[str]
    unreadable: str = ""


class LivePipeline:
    """Labelled frames of a rig that has started, from ``start`` to ``close``.

    frames: the newest one, for any number of lookers. latencies_ms: of the last frames. said: every complaint
    that has stood so far, by kind. complaints: those that stand now. error: what ended it.
    The rig is the caller's to close.
    """

    def __init__(self, rig: Rig, labelling: Labelling) -> None:
        self.rig, self.frames = rig, Newest[LiveFrame]()
        self.latencies_ms = deque[float](maxlen=LATENCIES)
        self.complaints: tuple[Complaint, ...] = ()
        self.said: dict[str, str] = {}
        self.error: Exception | None = None
        self._labelling, self._fuser = labelling, Fuser(rig.calibration)
        self._surveyed = Queue[_Surveyed | None](1)
        self._stop = threading.Event()
        self._standing, self._shift = Standing(), ShiftWatch()
        self._drift = DriftWatch(rig.calibration)
        works = self._survey_all, self._label_all
        self._threads = [threading.Thread(target=work, name=work.__name__, daemon=True) for work in works]

    def start(self) -> None:
        """Begin to label."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End both threads; idempotent."""
        self._stop.set()
        for thread in self._threads:
            if thread.is_alive():
                thread.join()

    # The surveying thread

    def _survey_all(self) -> None:
        seen, moments = 0, self.rig.moments
        try:
            while not self._stop.is_set():
                newest = moments.after(seen, WAIT_S)
                if newest is not None:
                    seen, moment = newest
                    self._hand_on(self._survey(moment))
                elif moments.ended:
                    break
        except Exception as error:  # whoever looks raises it: here it would die with the thread
            self.error = error
        self._hand_on(None)

    def _hand_on(self, surveyed: _Surveyed | None) -> None:
        while not self._stop.is_set():
            try:
                self._surveyed.put(surveyed, timeout=WAIT_S)
                return
            except Full:
                continue

    def _survey(self, moment: Moment) -> _Surveyed:
        frame, left_out = calibrated(moment.frame, self._fuser.calibration)
        frame = self._drift.corrected(moment, frame)
        unreadable = ""
        try:
            cloud = self._fuser.fuse_frame(frame)
        except FormatError as error:
            # A colour image that was cut off on its way.
            unreadable = str(error)
            cloud = self._fuser.fuse_frame(replace(frame, color_encoded=None))
        try:
            survey = self._labelling.survey(cloud)
        except CloudError as error:
            return _Surveyed(moment, cloud, None, left_out, str(error))
        return _Surveyed(moment, cloud, survey, left_out, unreadable)

    # The labelling thread

    def _label_all(self) -> None:
        before: FrameLabels | None = None
        try:
            while not self._stop.is_set():
                try:
                    surveyed = self._surveyed.get(timeout=WAIT_S)
                except Empty:
                    self._stand(rig_complaints(self.rig.health()))
                    continue
                if surveyed is None:
                    break
                before = self._label(surveyed, before)
        except Exception as error:  # as above
            self.error = self.error or error
        finally:
            self.frames.end()

    def _label(self, surveyed: _Surveyed, before: FrameLabels | None) -> FrameLabels | None:
        """Label a frame and show it; its labels, None where they failed."""
        moment, cloud = surveyed.moment, surveyed.cloud
        if surveyed.survey is None:
            self._left_out(surveyed.unreadable)
            return None
        try:
            result, person = self._labelling.label(surveyed.survey, before)
        except CloudError as error:
            self._left_out(str(error))
            return None
        labels = labels_of(f"{moment.frame.index:06d}", cloud.depth_mm, result, person, surveyed.left_out)
        stance = self._labelling.stance(labels, cloud.camera)
        health = self.rig.health()
        made = [*rig_complaints(health), *self._of_frame(surveyed, person, result)]
        self._stand(made)
        latency_ms = (time.monotonic_ns() - moment.arrival_ns) * 1e-6
        self.latencies_ms.append(latency_ms)
        self.frames.put(LiveFrame(moment, cloud, labels, stance, health, self.complaints, latency_ms))
        return labels

    def _left_out(self, why: str) -> None:
        """Say why a frame has no labels."""
        self._stand([*rig_complaints(self.rig.health()), Complaint("frame", why)])

    def _stand(self, made: Iterable[Complaint]) -> None:
        """Take the complaints of a moment: of a rig that gives no images, too."""
        self.complaints = self._standing.update(made, time.monotonic())
        self.said |= {complaint.kind: complaint.text for complaint in self.complaints}

    def _of_frame(self, surveyed: _Surveyed, person: PersonMask, result: Segmentation) -> list[Complaint]:
        moment, cloud = surveyed.moment, surveyed.cloud
        made = list(person_complaints(cloud, person.mask))
        if surveyed.unreadable:
            made.append(Complaint("frame", surveyed.unreadable))
        lit = not {"dark", "glare"} & {complaint.kind for complaint in made}
        if lit and result.reading is not None:
            made += filter(None, [color_complaint(cloud, person.mask, result.reading.model)])
        made += filter(None, [self._shift.complaint(cloud, person.mask, moment.arrival_ns)])
        return made

    def latency_ms(self, share: float) -> float:
        """Milliseconds within which this share of the last frames was labelled; NaN before the first."""
        latencies = list(self.latencies_ms)
        return float(np.quantile(latencies, share)) if latencies else float("nan")
