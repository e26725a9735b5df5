"""Label the frames of a recording: fuse each to a cloud, detect its persons, label their parts, store all."""

import shutil
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, cast

import numpy as np

from annotate.array_types import UInt16
from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.labelset.cast_note import cast_note
from annotate.labelset.claim import Claim, login
from annotate.labelset.label_set import LabelSet, as_read
from annotate.labelset.nameless import person_code
from annotate.labelset.scheme_note import scheme_note
from annotate.labelset.source_recording import recording_entry
from annotate.person.extract import PersonDetection, PersonMask
from annotate.scheme.merging import converts
from annotate.scheme.scheme import Scheme
from annotate.segmentation.labels_of_frame import labels_of, remarks_in, review_rank
from annotate.segmentation.segment import SuitSegmenter, View, view_of
from annotate.segmentation.segmented_person import Segmentation, unlabelled
from annotate.segmentation.suit_network import SuitNetwork, shipped_suit_network
from annotate.suit.palette import Suit, suit_to_toml
from sensors.errors import CloudError, ExistsError, Setting
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FrameSource, RigFrame
from sensors.rig.rig_calibration import RigCalibration, calibration_to_json

NO_SUIT = "no suit: only the person is extracted, its parts stay undefined"
WRITERS, MOST_UNWRITTEN = 2, 6  # threads; labelled frames that wait for the disk; untuned
DETECTORS, AHEAD = 2, 3  # threads; frames read before their turn; untuned, for two cores


class DepthCloud(Protocol):
    """Full or coarse cloud of an undistorted depth image (h, w)."""

    @property
    def depth_mm(self) -> UInt16: ...


C = TypeVar("C", bound=DepthCloud)
C_co = TypeVar("C_co", bound=DepthCloud, covariant=True)
S = TypeVar("S")


class FrameFuser(Protocol[C_co]):
    """Fusion of a frame's images to a cloud: ``Fuser`` or ``CoarseFuser``."""

    @property
    def calibration(self) -> RigCalibration: ...
    @property
    def camera(self) -> Intrinsics: ...
    def fuse(self, depth_mm: UInt16, /) -> C_co: ...
    def fuse_frame(self, frame: RigFrame) -> C_co: ...


class Labeller(Protocol[C, S]):
    """Steps that label a frame, in a scheme. ``detect`` does all work that needs no other frame.

    ``label`` takes the stored labels of the previous frame; None at first and after a failed frame.
    """

    @property
    def scheme(self) -> Scheme: ...
    def fuser(self, calibration: RigCalibration) -> FrameFuser[C]: ...
    def detect(self, cloud: C) -> S: ...
    def label(self, detection: S, before: FrameLabels | None) -> tuple[Segmentation, PersonMask]: ...


def label_cloud(
    labeller: Labeller[C, S], cloud: C, before: FrameLabels | None
) -> tuple[Segmentation, PersonMask]:
    """Return the segmentation and mask of a cloud's subject; before: previous labels."""
    return labeller.label(labeller.detect(cloud), before)


@dataclass(frozen=True)
class Run:
    """Result of labelling a source. failed: (frame id, reason) of frames without labels."""

    labels: LabelSet
    failed: tuple[tuple[str, str], ...]

    def review_order(self) -> list[str]:
        """Return the frame ids: frames with unsure islands, then the others; the least confident first."""
        return sorted(self.labels.frame_ids, key=lambda i: review_rank(self.labels.notes(i)))

    def remarks(self) -> dict[str, list[str]]:
        """Return each warning with the ids of its frames."""
        remarks: dict[str, list[str]] = {}
        for frame_id in self.labels.frame_ids:
            for note in remarks_in(self.labels.notes(frame_id)):
                remarks.setdefault(note, []).append(frame_id)
        return remarks


@dataclass(frozen=True)
class SuitDetection:
    """Cloud of a frame with its persons. likely: the subject, detected in this frame alone. seen: network
    input of the likely subject; None without a suit or a trusted subject.
    """

    cloud: ThermalCloud
    persons: PersonDetection
    likely: PersonMask
    seen: View | None

    def view(self, person: PersonMask) -> View | None:
        """Return the network input of a trusted subject; None with too few readable colours."""
        # The network distinguishes the subject from other persons, not these from one another.
        own, likely = (np.minimum(one.persons, 2) for one in (person, self.likely))
        if self.likely.trusted and np.array_equal(own, likely):
            return self.seen
        return view_of(self.cloud, self.persons, person)


@dataclass(frozen=True)
class SuitLabeller:
    """Labeller by the colours of a suit; without a suit, parts stay undefined.

    network: None = the shipped one, ``for_suit``. window_c: lowest and highest surface temperature of a
    person; None = from each frame. single_pass: label about every second pixel, for a live picture.
    """

    suit: Suit | None
    network: SuitNetwork | None = None
    window_c: tuple[float, float] | None = None
    single_pass: bool = False

    @property
    def scheme(self) -> Scheme:
        """Return the scheme of the labels: the network's."""
        return self._network.scheme

    @cached_property
    def _network(self) -> SuitNetwork:
        return self.network or shipped_suit_network().for_suit(self.suit)

    @property
    def notes(self) -> tuple[str, ...]:
        """Return warnings about the suit, about labels in another scheme, and about lost things."""
        if self.suit is None:
            return ()
        return (*self.suit.notes, *scheme_notes(self.suit.scheme, self._network))

    def fuser(self, calibration: RigCalibration) -> Fuser:
        """Return the fusion to full clouds."""
        return Fuser(calibration)

    def detect(self, cloud: ThermalCloud) -> SuitDetection:
        """Detect the persons of a cloud, from this frame alone."""
        persons = PersonDetection(CoarseCloud.of(cloud), self.window_c, self.suit)
        likely = persons.person(None)
        seen = view_of(cloud, persons, likely) if self.suit is not None and likely.trusted else None
        return SuitDetection(cloud, persons, likely, seen)

    def label(
        self, detection: SuitDetection, before: FrameLabels | None = None
    ) -> tuple[Segmentation, PersonMask]:
        """Return the segmentation and mask of a frame's subject; before: previous labels."""
        person = detection.persons.person(before)
        if not person.trusted or self.suit is None:
            notes = (NO_SUIT,) if person.trusted else ()
            return unlabelled(person.mask, *notes, scheme=self.scheme), person
        segmenter = SuitSegmenter(self.suit, self._network, self.single_pass)
        return segmenter.segment(detection.cloud, detection.view(person), person, before)


def scheme_notes(worn: Scheme, network: SuitNetwork) -> tuple[str, ...]:
    """Return why labels by a suit of the scheme ``worn`` have other parts, and which things they lack."""
    notes, given = [], network.scheme
    if not (converts(worn, given) and converts(given, worn)):
        notes.append(
            f"labels have the parts of scheme {given.name!r}, because parts of the suit's scheme "
            f"{worn.name!r} are coarser or lack a colour of their own"
        )
    if lost := sorted(network.own.things - given.things):
        notes.append(
            f"labels lack {', '.join(lost)} of the network, because scheme {given.name!r} has no such part; "
            "add it to the suit's scheme"
        )
    return tuple(notes)


def label_source(
    source: FrameSource, labeller: SuitLabeller, out: Path, progress: Callable[[int], None]
) -> Run:
    """Label every frame of ``source`` into the label set ``out``; arguments and errors as in ``run``."""
    return run(source, {"label": suit_step(labeller)}, out, labeller, progress)


def suit_step(labeller: SuitLabeller) -> dict[str, Any]:
    """Return the entry of a label set's manifest about the labels by a suit."""
    suit, window_c = labeller.suit, labeller.window_c
    return {
        "suit": suit_to_toml(suit) if suit else None,
        "window_c": list(window_c) if window_c else None,
        "weights_sha256": (labeller.network or shipped_suit_network()).sha256,
    }


def run(
    source: FrameSource,
    steps: dict[str, Any],
    out: Path,
    labeller: Labeller[C, S],
    progress: Callable[[int], None],
) -> Run:
    """Label every frame of a source into the label set ``out``; continue an interrupted run, with the bytes
    of an uninterrupted one.

    steps: settings by step, stored in ``out``. progress: called with 1 for each frame that is stored or has
    failed. Raises ExistsError when ``out`` is of another source or settings, and ClaimedError while another
    process writes it. When every frame fails, removes ``out`` and raises CloudError.
    """
    fuser = labeller.fuser(source.calibration)
    info = {"source": source.name, "calibration": calibration_to_json(source.calibration), "steps": steps}
    if source.sha256:
        info["sha256"] = source.sha256
    info |= recording_entry(source.path) | cast_note(source.cast) | scheme_note(labeller.scheme)
    labels = LabelSet.resume(out, fuser.camera, info)
    with Claim.take(out, login()):
        return finished(labels, _run(source, fuser, labels, labeller, progress))


def _run(
    source: FrameSource,
    fuser: FrameFuser[C],
    labels: LabelSet,
    labeller: Labeller[C, S],
    progress: Callable[[int], None],
) -> list[tuple[str, str]]:
    """Label all frames that have no labels yet; return (frame id, reason) of the failed frames."""
    done, subject = set(labels.frame_ids), source.subject if source.named else person_code(source.subject)
    failed: list[tuple[str, str]] = []
    before: FrameLabels | None = None

    def fuse(frame: RigFrame) -> _Fused[S]:
        if _id(frame.index) in done:
            return _Fused(fuser.fuse(frame.depth_mm).depth_mm, None, [])
        frame, left_out = calibrated(frame, fuser.calibration)
        cloud = fuser.fuse_frame(frame)
        return _Fused(cloud.depth_mm, labeller.detect(cloud), left_out)

    with ThreadPoolExecutor(WRITERS, "write") as writers:
        unwritten: deque[Future[None]] = deque()
        for frame_id, fused in _fused_ahead(source, fuse):
            if frame_id in done:
                before = check_same(labels, frame_id, fused.result().depth_mm)
                progress(1)
            else:
                try:
                    depth_mm, detection, left_out = fused.result()
                    result, person = labeller.label(cast(S, detection), before)
                    labelled = labels_of(frame_id, depth_mm, result, person, left_out)
                except CloudError as error:
                    failed.append((frame_id, str(error)))
                    before = None
                    progress(1)
                else:
                    labelled = replace(labelled, subject=subject)
                    unwritten.append(writers.submit(labels.write, labelled, result.probabilities))
                    before = as_read(labelled)
            while unwritten and (len(unwritten) > MOST_UNWRITTEN or unwritten[0].done()):
                unwritten.popleft().result()
                progress(1)
        for write in unwritten:
            write.result()
            progress(1)
    return failed


def _id(index: int) -> str:
    return f"{index:06d}"


class _Fused(NamedTuple, Generic[S]):
    """Depth image and detection of a frame. detection: None with stored labels. left_out: notes on missing
    streams.
    """

    depth_mm: UInt16
    detection: S | None
    left_out: list[str]


def _fused_ahead(
    source: FrameSource, fuse: Callable[[RigFrame], _Fused[S]]
) -> Iterator[tuple[str, Future[_Fused[S]]]]:
    """Yield the id and the pending result of each frame of a source; some are read and fused in advance."""
    frames = iter(source)
    with ThreadPoolExecutor(1, "read") as reader, ThreadPoolExecutor(DETECTORS, "fuse") as detectors:

        def start() -> tuple[Future[RigFrame | None], Future[_Fused[S]]]:
            read = reader.submit(next, frames, None)
            return read, detectors.submit(lambda: fuse(cast(RigFrame, read.result())))

        coming = deque(start() for _ in range(AHEAD))
        for index in count():
            read, fused = coming.popleft()
            if not isinstance(read.exception(), CloudError) and read.result() is None:
                return
            coming.append(start())
            yield _id(index), fused


def check_same(labels: LabelSet, frame_id: str, depth_mm: UInt16) -> FrameLabels:
    """Return the labels of a frame from an earlier run. Raises ExistsError if their depth image differs."""
    kept = labels.read(frame_id)
    if not np.array_equal(kept.depth_mm, depth_mm):
        raise ExistsError(
            f"{labels.path} holds another recording's frame {frame_id}; choose another folder",
            Setting.OVERWRITE,
        )
    return kept


def finished(labels: LabelSet, failed: list[tuple[str, str]]) -> Run:
    """Return the result of a run; if every frame failed, remove the label set and raise CloudError."""
    if failed and not len(labels):
        shutil.rmtree(labels.path)
        raise CloudError(
            f"none of the {len(failed)} frames could be labelled; frame {failed[0][0]}: {failed[0][1]}"
        )
    return Run(labels, tuple(failed))


def calibrated(frame: RigFrame, calibration: RigCalibration) -> tuple[RigFrame, list[str]]:
    """Return a frame without the images of uncalibrated cameras, and notes on these images."""
    notes = []
    if frame.color_encoded is not None and calibration.color is None:
        frame = replace(frame, color_encoded=None)
        notes.append("colour left out: its camera is not calibrated")
    if frame.thermal_c is not None and calibration.thermal is None:
        frame = replace(frame, thermal_c=None)
        notes.append("temperature left out: its camera is not calibrated")
    return frame, notes
