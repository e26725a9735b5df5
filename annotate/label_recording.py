"""Label set of a source: every frame fused, its person extracted, its suit read, and kept."""

import shutil
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np

from annotate.array_types import UInt16
from annotate.cloud.coarse import CoarseCloud, CoarseFuser
from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.labelset.claim import Claim, login
from annotate.labelset.images import Probabilities
from annotate.labelset.label_set import LabelSet, as_read
from annotate.labelset.source_recording import recording_entry
from annotate.parts import BACKGROUND
from annotate.person.extract import PersonMask, Survey
from annotate.segmentation.segment import LIGHT, View, read, view_of
from annotate.segmentation.segmented_person import Segmentation, unlabelled
from annotate.segmentation.suit_network import Reader, shipped_reader
from annotate.suit.palette import Suit, suit_to_toml
from sensors.errors import CloudError, ExistsError
from sensors.rig.frame import FrameSource, RigFrame
from sensors.rig.rig_calibration import RigCalibration, calibration_to_json

NO_SUIT = "no --suit: only the person is extracted, its parts stay undefined"
"""Note of frames labelled without a suit."""
WRITERS, MOST_UNWRITTEN = 2, 6
"""Frames written at once, beside the work on the next ones, since each waits for the disk; labelled frames
that are not written yet. Chosen by eye."""
SURVEYORS, AHEAD = 2, 3
"""Frames that are surveyed at once, and that are read and surveyed ahead of the one that is labelled. Chosen
by eye, for two cores."""


@dataclass(frozen=True)
class Run:
    """Label set of a run over a source. failed: (frame id, reason) of frames without labels."""

    labels: LabelSet
    failed: tuple[tuple[str, str], ...]

    def review_order(self) -> list[str]:
        """Frame ids, the least certain first."""
        return sorted(self.labels.frame_ids, key=lambda i: float(self.labels.notes(i).get("confidence", 0.0)))

    def remarks(self) -> dict[str, list[str]]:
        """Notes on omissions and defects, each with the ids of its frames."""
        remarks: dict[str, list[str]] = {}
        for frame_id in self.labels.frame_ids:
            for note in self.labels.notes(frame_id)["notes"]:
                remarks.setdefault(note, []).append(frame_id)
        return remarks


Labeller: TypeAlias = Callable[[Any, FrameLabels | None], tuple[Segmentation, PersonMask]]
"""Labels and mask of a frame, from its survey (or its cloud) and the labels of the previous frame."""


def label_source(
    source: FrameSource,
    suit: Suit | None,
    out: Path,
    progress: Callable[[int], None],
    window_c: tuple[float, float] | None = None,
    reader: Reader | None = None,
) -> Run:
    """Labels of every frame of ``source`` in the label set ``out``; frames already there are kept.

    Without a suit the person is extracted and its parts stay undefined. progress: called with 1 for each
    frame that is on the disk or has failed. window_c: surface temperatures of a person, degrees Celsius;
    None = found in each frame. reader: of suits, None = the shipped one. Raises the errors of ``run``.
    """
    reader = reader or shipped_reader()
    step = {
        "suit": suit_to_toml(suit) if suit else None,
        "window_c": list(window_c) if window_c else None,
        "weights_sha256": reader.sha256,
    }

    return run(
        source,
        {"label": step},
        out,
        suit_labeller(suit, reader),
        progress,
        lambda cloud: SuitSurvey.of(cloud, suit, window_c),
    )


@dataclass(frozen=True)
class SuitSurvey:
    """A cloud, and the persons in it, with all that needs no other frame.

    likely: the subject if no other frame tells; seen: what the reader sees of them, if they wear a suit.
    """

    cloud: ThermalCloud
    persons: Survey
    likely: PersonMask
    seen: View | None

    @classmethod
    def of(
        cls, cloud: ThermalCloud, suit: Suit | None, window_c: tuple[float, float] | None = None
    ) -> "SuitSurvey":
        """Survey of a cloud, made coarse; arguments as of ``Survey``."""
        # Who wears a suit is outlined by its reader: a glance is enough.
        persons = Survey(CoarseCloud.of(cloud), window_c, suit, glance=suit is not None)
        likely = persons.person(None)
        read = suit is not None and likely.trusted
        return cls(cloud, persons, likely, view_of(cloud, persons, likely) if read else None)

    def view(self, person: PersonMask) -> View | None:
        """What the reader sees of a trusted person of the frame; None where their colours cannot be read."""
        # Which number another person has is not seen.
        own, likely = (np.minimum(one.persons, 2) for one in (person, self.likely))
        if self.likely.trusted and np.array_equal(own, likely):
            return self.seen
        return view_of(self.cloud, self.persons, person)


def suit_labeller(suit: Suit | None, reader: Reader, *, glance: bool = False) -> Labeller:
    """Labeller of surveys by a suit; without one, parts stay undefined. glance: as of ``read``."""

    def labeller(survey: SuitSurvey, before: FrameLabels | None) -> tuple[Segmentation, PersonMask]:
        person = survey.persons.person(before)
        if not person.trusted:
            return unlabelled(person.mask), person
        if suit is None:
            return unlabelled(person.mask, NO_SUIT), person
        return read(survey.cloud, survey.view(person), person, suit, before, reader, glance=glance)

    return labeller


def run(
    source: FrameSource,
    steps: dict[str, Any],
    out: Path,
    labeller: Labeller,
    progress: Callable[[int], None],
    survey: Callable[[Any], Any] = lambda cloud: cloud,
    fuser: Callable[[RigCalibration], Fuser | CoarseFuser] = Fuser,
) -> Run:
    """Labels of every frame of a source, fused; an interrupted run resumes, and bad frames are listed.

    labeller: labels a survey, given the labels of the previous frame exactly as stored, None at first and
    after a failed frame, so that a resumed run ends with the same bytes. survey: everything about a cloud
    that needs no other frame, computed beside the work on the previous frame. fuser: what makes the clouds,
    whole or coarse ones. Frames are written beside the work on the next ones. Raises ExistsError when ``out``
    holds anything but the beginning of this very run, ClaimedError while another process writes it,
    CloudError when every frame is bad: then ``out`` is removed.
    """
    fusion = fuser(source.calibration)
    info = {"source": source.name, "calibration": calibration_to_json(source.calibration), "steps": steps}
    if source.sha256:
        info["sha256"] = source.sha256
    info |= recording_entry(source.path)
    labels = LabelSet.resume(out, fusion.camera, info)
    with Claim.take(out, login()):
        return finished(labels, _run(source, fusion, labels, labeller, progress, survey))


def _run(
    source: FrameSource,
    fuser: Fuser | CoarseFuser,
    labels: LabelSet,
    labeller: Labeller,
    progress: Callable[[int], None],
    survey: Callable[[Any], Any],
) -> list[tuple[str, str]]:
    """(frame id, reason) of the failed frames, after all frames without labels have been labelled."""
    done = set(labels.frame_ids)
    failed: list[tuple[str, str]] = []
    before: FrameLabels | None = None

    def fuse(frame: RigFrame) -> _Fused:
        if _id(frame.index) in done:
            return _Fused(fuser.fuse(frame.depth_mm).depth_mm, None, [])
        frame, left_out = calibrated(frame, fuser.calibration)
        cloud = fuser.fuse_frame(frame)
        return _Fused(cloud.depth_mm, survey(cloud), left_out)

    with ThreadPoolExecutor(WRITERS, "write") as writers:
        unwritten: deque[Future[None]] = deque()
        for frame_id, fused in _fused_ahead(source, fuse):
            if frame_id in done:
                before = check_same(labels, frame_id, fused.result().depth_mm)
                progress(1)
            else:
                try:
                    labelled, probabilities = _labelled(frame_id, fused.result(), labeller, before)
                except CloudError as error:
                    failed.append((frame_id, str(error)))
                    before = None
                    progress(1)
                else:
                    labelled = replace(labelled, subject=source.subject)
                    unwritten.append(writers.submit(labels.write, labelled, probabilities))
                    before = as_read(labelled)
            while unwritten and (len(unwritten) > MOST_UNWRITTEN or unwritten[0].done()):
                unwritten.popleft().result()
                progress(1)
        for write in unwritten:
            write.result()
            progress(1)
    return failed


def _id(index: int) -> str:
    """Id of a frame's labels."""
    return f"{index:06d}"


@dataclass(frozen=True)
class _Fused:
    """A fused frame. depth_mm: (h, w), undistorted. survey: the labeller's input; left_out: notes."""

    depth_mm: UInt16
    survey: Any
    left_out: list[str]


def _fused_ahead(
    source: FrameSource, fuse: Callable[[RigFrame], _Fused]
) -> Iterator[tuple[str, Future[_Fused]]]:
    """Ids of a source's frames, some of them read, fused and surveyed beside the work on those before.

    CloudErrors of the source, which cost one frame, and errors of ``fuse`` are raised by the future; other
    errors of the source in the frame's turn.
    """
    frames = iter(source)
    with ThreadPoolExecutor(1, "read") as reader, ThreadPoolExecutor(SURVEYORS, "fuse") as surveyors:

        def start() -> tuple[Future[RigFrame | None], Future[_Fused]]:
            read = reader.submit(next, frames, None)
            return read, surveyors.submit(lambda: fuse(cast(RigFrame, read.result())))

        coming = deque(start() for _ in range(AHEAD))
        for index in count():
            read, fused = coming.popleft()
            if not isinstance(read.exception(), CloudError) and read.result() is None:
                return
            coming.append(start())
            yield _id(index), fused


def check_same(labels: LabelSet, frame_id: str, depth_mm: UInt16) -> FrameLabels:
    """Labels of a frame from an earlier run. Raises ExistsError if of another depth image (h, w)."""
    kept = labels.read(frame_id)
    if not np.array_equal(kept.depth_mm, depth_mm):
        raise ExistsError(
            f"{labels.path} holds another recording's frame {frame_id}; choose another folder "
            "or pass --overwrite"
        )
    return kept


def finished(labels: LabelSet, failed: list[tuple[str, str]]) -> Run:
    """Run with its failed frames. Raises CloudError when all failed, and removes the empty label set."""
    if failed and not len(labels):
        shutil.rmtree(labels.path)
        raise CloudError(
            f"none of the {len(failed)} frames could be labelled; frame {failed[0][0]}: {failed[0][1]}"
        )
    return Run(labels, tuple(failed))


def notes_of(result: Segmentation, remarks: Sequence[str] = ()) -> dict[str, Any]:
    """Notes of a frame's labels: mean confidence on the person, remarks, stored probabilities."""
    on_person = result.confidence[result.parts != BACKGROUND]
    return {
        "confidence": round(float(on_person.mean()), 4) if on_person.size else 0.0,
        "notes": [*remarks, *result.notes],
        **(result.probabilities.note() if result.probabilities else {}),
        **({"bearing": result.bearing} if result.bearing else {}),
    }


def _labelled(
    frame_id: str, fused: _Fused, labeller: Labeller, before: FrameLabels | None
) -> tuple[FrameLabels, Probabilities | None]:
    """Labels of a fused frame, and their probabilities if kept."""
    result, person = labeller(fused.survey, before)
    return labels_of(frame_id, fused.depth_mm, result, person, fused.left_out), result.probabilities


def labels_of(
    frame_id: str, depth_mm: UInt16, result: Segmentation, person: PersonMask, left_out: Sequence[str] = ()
) -> FrameLabels:
    """Labels of a frame from what was found in it. depth_mm: (h, w), undistorted; left_out: notes."""
    notes = notes_of(result, [*left_out, *person.notes]) | {"extraction": person.method}
    notes |= {"people": person.known} if person.known else {}
    notes |= {LIGHT: result.light.log_gain.round(3).tolist()} if result.light else {}
    persons = np.where(person.mask, np.uint8(1), np.where(person.others, person.persons, np.uint8(0)))
    return FrameLabels(frame_id, depth_mm, result.parts, result.confidence, notes=notes, persons=persons)


def calibrated(frame: RigFrame, calibration: RigCalibration) -> tuple[RigFrame, list[str]]:
    """Frame without the images of uncalibrated cameras, and notes on these."""
    notes = []
    if frame.color_encoded is not None and calibration.color is None:
        frame = replace(frame, color_encoded=None)
        notes.append("colour left out: its camera is not calibrated")
    if frame.thermal_c is not None and calibration.thermal is None:
        frame = replace(frame, thermal_c=None)
        notes.append("temperature left out: its camera is not calibrated")
    return frame, notes
