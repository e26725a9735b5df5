"""The labelling run: every frame of a source fused, its person extracted, its suit read, and kept."""

import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.cloud import ThermalCloud
from annotate.fuse import Fuser
from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND, UNDEFINED
from annotate.person import WINDOW_C, PersonMask, extract_person
from annotate.segment import Segmentation, segment
from annotate.store import LabelSet
from annotate.suit import Suit, suit_to_toml
from sensors.calibration import RigCalibration, calibration_to_json
from sensors.errors import CloudError, ExistsError
from sensors.frame import RigFrame
from sensors.source import FrameSource


@dataclass(frozen=True)
class Run:
    """What a run over a source came to. failed: (frame id, why) of frames that could not be done."""

    labels: LabelSet
    failed: tuple[tuple[str, str], ...]

    def review_order(self) -> list[str]:
        """Frame ids, the least certain first."""
        return sorted(self.labels.frame_ids, key=lambda i: float(self.labels.notes(i).get("confidence", 0.0)))

    def remarks(self) -> dict[str, int]:
        """What was left out or went wrong, and in how many frames."""
        return dict(Counter(note for i in self.labels.frame_ids for note in self.labels.notes(i)["notes"]))


def label_source(
    source: FrameSource,
    suit: Suit | None,
    out: Path,
    progress: Callable[[int], None],
    window_c: tuple[float, float] = WINDOW_C,
) -> Run:
    """Label every frame of ``source`` into the label set ``out``; frames already there are kept.

    Without a suit the person is extracted and its parts stay undefined. ``progress`` is called with 1 a
    frame. Raises what ``run`` raises.
    """
    step = {"suit": suit_to_toml(suit) if suit else None, "window_c": list(window_c)}

    def one(cloud: ThermalCloud) -> tuple[Segmentation, PersonMask]:
        person = extract_person(cloud, window_c)
        return (segment(cloud, person.mask, suit) if suit else _unlabelled(person.mask)), person

    return run(source, {"label": step}, out, one, progress)


def run(
    source: FrameSource,
    steps: dict[str, Any],
    out: Path,
    one: Callable[[ThermalCloud], tuple[Segmentation, PersonMask]],
    progress: Callable[[int], None],
) -> Run:
    """Fuse every frame of a source and keep what ``one`` makes of it; resumes, and outlives bad frames.

    Raises ExistsError when ``out`` holds something else than the beginning of this very run, CloudError
    when every frame is bad: then nothing is left behind.
    """
    fuser = Fuser(source.calibration)
    info = {"source": source.name, "calibration": calibration_to_json(source.calibration), "steps": steps}
    labels = LabelSet.resume(out, fuser.camera, info)
    done, failed = set(labels.frame_ids), []
    for frame in source:
        frame_id = f"{frame.index:06d}"
        if frame_id in done:
            check_same(labels, frame_id, fuser.fuse(frame.depth_mm).depth_mm)
        else:
            try:
                labels.write(_labelled(frame_id, frame, fuser, one))
            except CloudError as error:
                failed.append((frame_id, str(error)))
        progress(1)
    return finished(labels, failed)


def check_same(labels: LabelSet, frame_id: str, depth_mm: NDArray[np.uint16]) -> None:
    """Raise ExistsError unless a frame kept by an earlier run shows this very depth image (h, w)."""
    if not np.array_equal(labels.read(frame_id).depth_mm, depth_mm):
        raise ExistsError(
            f"{labels.path} holds another recording's frame {frame_id}; choose another folder "
            "or pass --overwrite"
        )


def finished(labels: LabelSet, failed: list[tuple[str, str]]) -> Run:
    """What a run came to. Raises CloudError when all failed, and takes the empty label set away."""
    if failed and not len(labels):
        shutil.rmtree(labels.path)
        raise CloudError(
            f"none of the {len(failed)} frames could be done; frame {failed[0][0]}: {failed[0][1]}"
        )
    return Run(labels, tuple(failed))


def _labelled(
    frame_id: str,
    frame: RigFrame,
    fuser: Fuser,
    one: Callable[[ThermalCloud], tuple[Segmentation, PersonMask]],
) -> FrameLabels:
    frame, left_out = _calibrated(frame, fuser.calibration)
    cloud = fuser.fuse_frame(frame)
    result, person = one(cloud)
    on_person = result.confidence[result.parts != BACKGROUND]
    notes = {
        "confidence": round(float(on_person.mean()), 4) if on_person.size else 0.0,
        "extraction": person.method,
        "notes": [*left_out, *person.notes, *result.notes],
    }
    return FrameLabels(frame_id, cloud.depth_mm, result.parts, result.confidence, notes=notes)


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


def _unlabelled(mask: NDArray[np.bool_]) -> Segmentation:
    parts = np.where(mask, UNDEFINED, BACKGROUND).astype(np.uint8)
    note = "no --suit: only the person is extracted, its parts stay undefined"
    return Segmentation(parts, np.zeros(mask.shape, np.float32), (note,))
