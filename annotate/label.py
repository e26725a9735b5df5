"""The labelling run: every frame of a source fused, its person extracted, its suit read, and kept."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.cloud import ThermalCloud
from annotate.fuse import Fuser
from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND, UNDEFINED
from annotate.person import PersonMask, extract_person
from annotate.segment import Segmentation, segment
from annotate.store import LabelSet
from annotate.suit import Suit, suit_to_toml
from sensors.calibration import calibration_to_json
from sensors.errors import CloudError
from sensors.frame import RigFrame
from sensors.source import FrameSource

WINDOW_C = (25.0, 35.0)
"""Temperatures of a person in a room (Nishi & Miura 2017, section 4.2.1)."""


@dataclass(frozen=True)
class Run:
    """What a run over a source came to. failed: (frame id, why) of frames that could not be done."""

    labels: LabelSet
    failed: tuple[tuple[str, str], ...]

    def review_order(self) -> list[str]:
        """Frame ids, the least certain first."""
        return sorted(self.labels.frame_ids, key=lambda i: float(self.labels.notes(i).get("confidence", 0.0)))


def label_source(
    source: FrameSource,
    suit: Suit | None,
    out: Path,
    progress: Callable[[int], None],
    window_c: tuple[float, float] = WINDOW_C,
) -> Run:
    """Label every frame of ``source`` into the label set ``out``; frames already there are kept.

    Without a suit the person is extracted and its parts stay undefined. ``progress`` is called with 1 a
    frame. Raises ExistsError when ``out`` holds something else than the beginning of this very run.
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
    """Fuse every frame of a source and keep what ``one`` makes of it; resumes, and outlives bad frames."""
    fuser = Fuser(source.calibration)
    info = {"source": source.name, "calibration": calibration_to_json(source.calibration), "steps": steps}
    labels = LabelSet.resume(out, fuser.camera, info)
    done, failed = set(labels.frame_ids), []
    for frame in source:
        frame_id = f"{frame.index:06d}"
        try:
            if frame_id not in done:
                labels.write(_labelled(frame_id, frame, fuser, one))
        except CloudError as error:
            failed.append((frame_id, str(error)))
        progress(1)
    return Run(labels, tuple(failed))


def _labelled(
    frame_id: str,
    frame: RigFrame,
    fuser: Fuser,
    one: Callable[[ThermalCloud], tuple[Segmentation, PersonMask]],
) -> FrameLabels:
    cloud = fuser.fuse_frame(frame)
    result, person = one(cloud)
    on_person = result.confidence[result.parts != BACKGROUND]
    notes = {
        "confidence": round(float(on_person.mean()), 4) if on_person.size else 0.0,
        "extraction": person.method,
        "notes": [*person.notes, *result.notes],
    }
    return FrameLabels(frame_id, cloud.depth_mm, result.parts, result.confidence, notes=notes)


def _unlabelled(mask: NDArray[np.bool_]) -> Segmentation:
    parts = np.where(mask, UNDEFINED, BACKGROUND).astype(np.uint8)
    return Segmentation(parts, np.zeros(mask.shape, np.float32), ("no suit given: parts are undefined",))
