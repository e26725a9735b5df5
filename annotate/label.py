"""The labelling run: every frame of a source fused, its person extracted, its suit read, and kept."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from annotate.cleanup import tidied
from annotate.cloud import ThermalCloud
from annotate.fuse import Fuser
from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND
from annotate.person import PersonMask, extract_person
from annotate.probabilities import Probabilities
from annotate.segment import Segmentation, segment, unlabelled
from annotate.store import LabelSet
from annotate.suit import Suit, suit_to_toml
from sensors.calibration import RigCalibration, calibration_to_json
from sensors.errors import CloudError, ExistsError
from sensors.frame import RigFrame
from sensors.source import FrameSource

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


Labeller: TypeAlias = Callable[[ThermalCloud, FrameLabels | None], tuple[Segmentation, PersonMask]]
"""What makes labels of a cloud and the labels of the frame before it."""


def label_source(
    source: FrameSource,
    suit: Suit | None,
    out: Path,
    progress: Callable[[int], None],
    window_c: tuple[float, float] | None = None,
) -> Run:
    """Label every frame of ``source`` into the label set ``out``; frames already there are kept.

    Without a suit the person is extracted and its parts stay undefined. window_c: surface temperatures of
    a person, degrees Celsius; None: found in each frame. ``progress`` is called with 1 a frame. Raises what
    ``run`` raises.
    """
    step = {"suit": suit_to_toml(suit) if suit else None, "window_c": list(window_c) if window_c else None}

    def one(cloud: ThermalCloud, before: FrameLabels | None) -> tuple[Segmentation, PersonMask]:
        person = extract_person(cloud, window_c, before, suit)
        if not person.trusted:
            return unlabelled(person.mask), person
        if suit is None:
            return unlabelled(person.mask, NO_SUIT), person
        return _tidied(segment(cloud, person.mask, suit, before), person, cloud)

    return run(source, {"label": step}, out, one, progress)


def run(
    source: FrameSource, steps: dict[str, Any], out: Path, one: Labeller, progress: Callable[[int], None]
) -> Run:
    """Fuse every frame of a source and keep what ``one`` makes of it; resumes, and outlives bad frames.

    ``one`` is given the labels of the frame before exactly as they are stored, None at first and after a
    frame that failed: so a run that broke off goes on to the same bytes. Raises ExistsError when ``out``
    holds something else than the beginning of this very run, CloudError when every frame is bad: then
    nothing is left behind.
    """
    fuser = Fuser(source.calibration)
    info = {"source": source.name, "calibration": calibration_to_json(source.calibration), "steps": steps}
    labels = LabelSet.resume(out, fuser.camera, info)
    done, failed = set(labels.frame_ids), []
    before: FrameLabels | None = None
    for frame in source:
        frame_id = f"{frame.index:06d}"
        if frame_id in done:
            before = check_same(labels, frame_id, fuser.fuse(frame.depth_mm).depth_mm)
        else:
            try:
                labels.write(*_labelled(frame_id, frame, fuser, one, before))
                before = labels.read(frame_id)
            except CloudError as error:
                failed.append((frame_id, str(error)))
                before = None
        progress(1)
    return finished(labels, failed)


def _tidied(found: Segmentation, person: PersonMask, cloud: ThermalCloud) -> tuple[Segmentation, PersonMask]:
    """Both without the islands that a person's first key would take away."""
    parts = tidied(found.parts, cloud.depth_mm)
    loose = (parts == BACKGROUND) & (found.parts != BACKGROUND)
    confidence = np.where(loose, np.float32(0), found.confidence)
    return replace(found, parts=parts, confidence=confidence), replace(person, mask=person.mask & ~loose)


def check_same(labels: LabelSet, frame_id: str, depth_mm: NDArray[np.uint16]) -> FrameLabels:
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
            f"none of the {len(failed)} frames could be done; frame {failed[0][0]}: {failed[0][1]}"
        )
    return Run(labels, tuple(failed))


def _labelled(
    frame_id: str, frame: RigFrame, fuser: Fuser, one: Labeller, before: FrameLabels | None
) -> tuple[FrameLabels, Probabilities | None]:
    frame, left_out = _calibrated(frame, fuser.calibration)
    cloud = fuser.fuse_frame(frame)
    result, person = one(cloud, before)
    on_person = result.confidence[result.parts != BACKGROUND]
    notes: dict[str, Any] = {
        "confidence": round(float(on_person.mean()), 4) if on_person.size else 0.0,
        "extraction": person.method,
        "notes": [*left_out, *person.notes, *result.notes],
        **(result.probabilities.note() if result.probabilities else {}),
    }
    persons = np.where(person.mask, np.uint8(1), np.where(person.others, np.uint8(2), np.uint8(0)))
    labelled = FrameLabels(
        frame_id, cloud.depth_mm, result.parts, result.confidence, notes=notes, persons=persons
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
