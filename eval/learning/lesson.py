"""What a label set's corrections teach: the person as extracted at first, and the parts that people gave."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from annotate.array_types import Float32, UInt8, UInt16
from annotate.correction.correction import Correction
from annotate.crop import network_crop, normalize, person_of
from annotate.frame_labels import FrameLabels
from annotate.parts import BACKGROUND, on_body
from eval.network.predict import check_alone
from eval.training.crops import DEPTH_STEPS, Crops
from eval.training.whole import nothing_known
from sensors.errors import CloudError

LEAST_FRAMES = 3
"""Corrected frames from which anything is learnt: fewer show one side of the person. Chosen by eye."""
HELD_OUT = 4
"""Of so many corrected frames one is held out, to measure on what was not learnt. Chosen by eye."""


@dataclass(frozen=True)
class Taught:
    """A frame that a person has finished. first: its labels before all work; corrected: as they are now."""

    first: FrameLabels
    corrected: FrameLabels

    def crop(self) -> tuple[UInt16, UInt8, Float32]:
        """As ``Crops`` takes it. What the extraction took along shows, and is background in the parts."""
        mask = person_of(self.first.parts) & (self.first.depth_mm > 0)
        square = network_crop(mask)
        depth = normalize(square.cut(self.first.depth_mm, 0), square.cut(mask, False))
        parts = square.cut(self.corrected.parts, BACKGROUND)
        return np.rint(depth * DEPTH_STEPS).astype(np.uint16), parts, nothing_known()


def lessons(path: Path) -> list[Taught]:
    """The frames of a label set that people have accepted or reviewed, in order.

    Raises CloudError where they are too few, where everybody is labelled, or where a suit was read: networks
    see no colours.
    """
    with Correction.open(path, read_only=True) as correction:
        check_alone(correction.labels)
        steps = correction.labels.info.get("steps")
        if isinstance(steps, dict) and (steps.get("label") or {}).get("suit"):
            raise CloudError(
                f"{path} was labelled from a suit, which a network cannot learn; see train-labels"
            )
        labels = correction.labels
        done = [i for i in labels.frame_ids if correction.state(i) in ("accepted", "reviewed")]
        found = (Taught(labels.read(i, original=labels.has_original(i)), correction.frame(i)) for i in done)
        taught = [one for one in found if _shows_parts(one)]
    if len(taught) < LEAST_FRAMES:
        raise CloudError(
            f"{path} has {len(taught)} accepted frames with parts; accept at least {LEAST_FRAMES} with fix"
        )
    return taught


def _shows_parts(taught: Taught) -> bool:
    there = person_of(taught.first.parts) & (taught.first.depth_mm > 0)
    return bool((there & on_body(taught.corrected.parts)).any())


def divided(taught: Sequence[Taught]) -> tuple[list[Taught], list[Taught]]:
    """Frames to learn from, and frames to measure on, evenly among them: none of fewer than HELD_OUT."""
    held = {HELD_OUT // 2 + HELD_OUT * k for k in range(len(taught) // HELD_OUT)}
    return (
        [one for n, one in enumerate(taught) if n not in held],
        [one for n, one in enumerate(taught) if n in held],
    )


def crops_of(taught: Sequence[Taught], images: int) -> Crops:
    """That many crops; no frame appears more than once more often than another."""
    once = [one.crop() for one in taught]

    def again() -> Iterator[tuple[UInt16, UInt8, Float32]]:
        for n in range(images):
            yield once[n % len(once)]

    return Crops.of(again())
