"""The labelling run: every frame of a source fused, its person extracted, its suit read, and kept."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np

from annotate.array_types import UInt16
from annotate.cleanup import tidied
from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.engine import Engine
from annotate.frame_labels import FrameLabels
from annotate.labelset.claim import Claim, login
from annotate.labelset.probabilities import Probabilities
from annotate.labelset.store import LabelSet
from annotate.parts import BACKGROUND
from annotate.person.extract import PersonMask, Survey
from annotate.second_look.look import look_again
from annotate.segmentation.segment import Segmentation, segment, unlabelled
from annotate.suit.palette import Suit, suit_to_toml
from sensors.errors import CloudError, ExistsError
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration, calibration_to_json
from sensors.rig.source import FrameSource
from sensors.session.reader import Session

NO_SUIT = "no --suit: only the person is extracted, its parts stay undefined"


@dataclass(frozen=True)
class Run:
    """What a run over a source came to. failed: (frame id, why) of frames that could not be done."""

    labels: LabelSet
    failed: tuple[tuple[str, str], ...]

    def review_order(self) -> list[str]:
        """Frame ids, the least certain first."""
        return sorted(self.labels.frame_ids, key=lambda i: float(self.labels.notes(i).get("confidence", 0.0)))

    def remarks(self) -> dict[str, list[str]]:
        """What was left out or went wrong, and the ids of the frames."""
        remarks: dict[str, list[str]] = {}
        for frame_id in self.labels.frame_ids:
            for note in self.labels.notes(frame_id)["notes"]:
                remarks.setdefault(note, []).append(frame_id)
        return remarks


Labeller: TypeAlias = Callable[[Any, FrameLabels | None], tuple[Segmentation, PersonMask]]
"""What makes labels of a cloud, or what was seen in it ahead, and the labels of the frame before it."""


def label_source(
    source: FrameSource,
    suit: Suit | None,
    out: Path,
    progress: Callable[[int], None],
    window_c: tuple[float, float] | None = None,
    engine: Engine | None = None,
) -> Run:
    """Label every frame of ``source`` into the label set ``out``; frames already there are kept.

    Without a suit the person is extracted and its parts stay undefined. window_c: surface temperatures of
    a person, degrees Celsius; None: found in each frame. engine: None for the shipped one. ``progress`` is
    called with 1 a frame. Raises what ``run`` raises.
    """
    engine = engine or Engine()
    step = {
        "suit": suit_to_toml(suit) if suit else None,
        "window_c": list(window_c) if window_c else None,
        **engine.note(),
    }

    def one(survey: Survey, before: FrameLabels | None) -> tuple[Segmentation, PersonMask]:
        person, cloud = survey.person(before), survey.cloud
        if not person.trusted:
            return unlabelled(person.mask), person
        if suit is None:
            return unlabelled(person.mask, NO_SUIT), person
        found = segment(cloud, person.mask, suit, before, engine)
        if engine.steps.second_look:
            found, person = look_again(cloud, person, found, before, engine)
        return cleaned(found, person, cloud) if engine.steps.tidying else (found, person)

    return run(
        source, {"label": step}, out, one, progress, lambda cloud: Survey(cloud, window_c, suit, engine)
    )


def run(
    source: FrameSource,
    steps: dict[str, Any],
    out: Path,
    one: Labeller,
    progress: Callable[[int], None],
    look: Callable[[ThermalCloud], Any] = lambda cloud: cloud,
) -> Run:
    """Fuse every frame of a source and keep what ``one`` makes of it; resumes, and outlives bad frames.

    ``one`` is given the labels of the frame before exactly as they are stored, None at first and after a
    frame that failed: so a run that broke off goes on to the same bytes. ``look`` makes of a cloud what
    ``one`` is given, beside the work on the frame before and without its labels. Raises ExistsError when
    ``out`` holds something else than the beginning of this very run, ClaimedError while somebody else writes
    it, CloudError when every frame is bad: then nothing is left behind.
    """
    fuser = Fuser(source.calibration)
    info = {"source": source.name, "calibration": calibration_to_json(source.calibration), "steps": steps}
    if isinstance(source, Session):
        info["sha256"] = source.sha256
    labels = LabelSet.resume(out, fuser.camera, info)
    with Claim.take(out, login()):
        return finished(labels, _run(source, fuser, labels, one, progress, look))


def _run(
    source: FrameSource,
    fuser: Fuser,
    labels: LabelSet,
    one: Labeller,
    progress: Callable[[int], None],
    look: Callable[[ThermalCloud], Any],
) -> list[tuple[str, str]]:
    """Label the frames that are not done yet; (frame id, why) of those that failed."""
    done = set(labels.frame_ids)
    failed: list[tuple[str, str]] = []
    before: FrameLabels | None = None

    def fuse(frame: RigFrame) -> _Seen:
        if _id(frame) in done:
            return _Seen(fuser.fuse(frame.depth_mm).depth_mm, None, [])
        frame, left_out = _calibrated(frame, fuser.calibration)
        cloud = fuser.fuse_frame(frame)
        return _Seen(cloud.depth_mm, look(cloud), left_out)

    for frame, seen in _ahead(source, fuse):
        frame_id = _id(frame)
        if frame_id in done:
            before = check_same(labels, frame_id, seen.result().depth_mm)
        else:
            try:
                labels.write(*_labelled(frame_id, seen.result(), one, before))
                before = labels.read(frame_id)
            except CloudError as error:
                failed.append((frame_id, str(error)))
                before = None
        progress(1)
    return failed


def _id(frame: RigFrame) -> str:
    return f"{frame.index:06d}"


@dataclass(frozen=True)
class _Seen:
    """A fused frame. depth_mm: (h, w), undistorted. content: what the labeller is given; left_out: notes."""

    depth_mm: UInt16
    content: Any
    left_out: list[str]


def _ahead(
    source: FrameSource, fuse: Callable[[RigFrame], _Seen]
) -> Iterator[tuple[RigFrame, Future[_Seen]]]:
    """The frames of a source, each read, fused and looked at beside the work on the one before it.

    What the source raises is raised in the frame's turn, what ``fuse`` raises by the future.
    """
    frames = iter(source)

    def start(pool: ThreadPoolExecutor) -> tuple[Future[RigFrame | None], Future[_Seen]]:
        read = pool.submit(next, frames, None)
        return read, pool.submit(lambda: fuse(cast(RigFrame, read.result())))

    with ThreadPoolExecutor(1, "fuse") as pool:
        coming = start(pool)
        while (frame := coming[0].result()) is not None:
            now, coming = coming[1], start(pool)
            yield frame, now


def cleaned(found: Segmentation, person: PersonMask, cloud: ThermalCloud) -> tuple[Segmentation, PersonMask]:
    """Both without the islands that a person's first key would take away."""
    parts = tidied(found.parts, cloud.depth_mm)
    loose = (parts == BACKGROUND) & (found.parts != BACKGROUND)
    confidence = np.where(loose, np.float32(0), found.confidence)
    return replace(found, parts=parts, confidence=confidence), replace(person, mask=person.mask & ~loose)


def check_same(labels: LabelSet, frame_id: str, depth_mm: UInt16) -> FrameLabels:
    """A frame kept by an earlier run. Raises ExistsError unless it shows this very depth image (h, w)."""
    kept = labels.read(frame_id)
    if not np.array_equal(kept.depth_mm, depth_mm):
        raise ExistsError(
            f"{labels.path} holds another recording's frame {frame_id}; choose another folder "
            "or pass --overwrite"
        )
    return kept


def finished(labels: LabelSet, failed: list[tuple[str, str]]) -> Run:
    """What a run came to. Raises CloudError when all failed, and takes the empty label set away."""
    if failed and not len(labels):
        shutil.rmtree(labels.path)
        raise CloudError(
            f"none of the {len(failed)} frames could be labelled; frame {failed[0][0]}: {failed[0][1]}"
        )
    return Run(labels, tuple(failed))


def notes_of(result: Segmentation, remarks: Sequence[str] = ()) -> dict[str, Any]:
    """What a frame's notes say of its labels: confidence on the person, remarks, stored probabilities."""
    on_person = result.confidence[result.parts != BACKGROUND]
    return {
        "confidence": round(float(on_person.mean()), 4) if on_person.size else 0.0,
        "notes": [*remarks, *result.notes],
        **(result.probabilities.note() if result.probabilities else {}),
    }


def _labelled(
    frame_id: str, seen: _Seen, one: Labeller, before: FrameLabels | None
) -> tuple[FrameLabels, Probabilities | None]:
    result, person = one(seen.content, before)
    notes = notes_of(result, [*seen.left_out, *person.notes]) | {"extraction": person.method}
    persons = np.where(person.mask, np.uint8(1), np.where(person.others, np.uint8(2), np.uint8(0)))
    labelled = FrameLabels(
        frame_id, seen.depth_mm, result.parts, result.confidence, notes=notes, persons=persons
    )
    return labelled, result.probabilities


def _calibrated(frame: RigFrame, calibration: RigCalibration) -> tuple[RigFrame, list[str]]:
    """The frame without images whose camera is not calibrated, and what was left out."""
    notes = []
    if frame.color_encoded is not None and calibration.color is None:
        frame = replace(frame, color_encoded=None)
        notes.append("colour left out: its camera is not calibrated")
    if frame.thermal_c is not None and calibration.thermal is None:
        frame = replace(frame, thermal_c=None)
        notes.append("temperature left out: its camera is not calibrated")
    return frame, notes
