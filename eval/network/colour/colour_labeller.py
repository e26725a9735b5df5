"""Labels of recordings by a colour network: its people, landmarks and masks beside the depth network."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from annotate.array_types import Bool, UInt8
from annotate.cloud.coarse import CoarseCloud
from annotate.frame_labels import FrameLabels
from annotate.label_recording import Run, run
from annotate.person.extract import PersonDetection, PersonMask
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Scheme
from annotate.segmentation.segmented_person import Segmentation, unlabelled
from annotate.witness.coloured_cloud import ColouredCloud, ColourFuser
from annotate.witness.fusion import in_scheme
from annotate.witness.person_crop import PersonCrop
from annotate.witness.person_outline import Outline, person_outline
from annotate.witness.pose_network import LEAST, SURER, WIDENED, PosedPerson, PoseNetwork, people_in
from annotate.witness.shown_person import NOTE, ShownPerson
from annotate.witness.skeleton import Skeleton
from eval.network.body_state import BodyState
from eval.network.colour.witness_network import corrected, shipped_witness_network
from eval.network.colour.witnessed_body import witnessed_body
from eval.network.onnx_network import OnnxNetwork
from eval.network.posture_model import with_posture
from eval.network.predict_source import joined
from sensors.rig.camera import project
from sensors.rig.frame import FrameSource
from sensors.rig.rig_calibration import RigCalibration

SAME = 0.3  # least share of a witnessed person that lies on a person found in depth; untuned
NO_COLOUR = "no colour image: parts are undefined"
NOBODY = "the colour network shows no person: parts are undefined"
UNSEEN = "the colour network does not show a person found in depth, which is undefined"


def label_by_colour(
    source: FrameSource, labeller: "ColourLabeller", out: Path, progress: Callable[[int], None]
) -> Run:
    """Label the people of every frame of a source into the label set ``out``; resume an interrupted run.

    Raises the errors of ``label_recording.run``, and CalibrationError for colour without a calibration.
    """
    return run(source, {"label_by_colour": labeller.step}, out, labeller, progress)


@dataclass(frozen=True, eq=False)
class ColourDetection:
    """Frame with the people found in depth, and the pixels (h, w) and labels of each witnessed person."""

    cloud: ColouredCloud
    persons: PersonDetection
    witnessed: list[tuple[Bool, Segmentation]]


@dataclass(frozen=True, eq=False)
class ColourLabeller:
    """Labeller by a 2-D pose network on colour (``annotate.label_recording.Labeller``).

    everybody: label all witnessed people, not the subject alone. window_c: as in ``PersonDetection``.
    """

    witness: PoseNetwork
    network: OnnxNetwork
    scheme: Scheme
    everybody: bool = False
    window_c: tuple[float, float] | None = None

    @property
    def step(self) -> dict[str, Any]:
        """Return the entry of a label set's manifest about the networks."""
        return {
            "witness": self.witness.sha256,
            "weights": self.network.sha256,
            "window_c": list(self.window_c) if self.window_c else None,
            "everybody": self.everybody,
        }

    def fuser(self, calibration: RigCalibration) -> ColourFuser:
        """Return the fusion of depth and colour. Raises CalibrationError as ``ColourFuser``."""
        return ColourFuser(calibration)

    def detect(self, cloud: ColouredCloud) -> ColourDetection:
        """Find the people of a frame in depth and in colour, and label each witnessed person."""
        persons = PersonDetection(CoarseCloud.of(cloud.cloud), self.window_c, everybody=True)
        witnessed = list[tuple[Bool, Segmentation]]()
        if cloud.rgb is not None:
            whose = persons.person().persons
            taken = np.zeros(whose.shape, np.bool_)
            for person in self._people(cloud, whose):
                shown = person_outline(cloud, person, tuple(self.witness.names), (whose > 0) & ~taken)
                if shown is not None and (shown.mask & ~taken).any():
                    shown = shown._replace(mask=shown.mask & ~taken)
                    mask, labels = self._labelled(cloud, shown, taken)
                    bearing = (labels.bearing or {}) | {NOTE: _shown(cloud, person, shown.skeleton)}
                    witnessed.append((mask, replace(labels, bearing=bearing)))
                    taken |= mask
        return ColourDetection(cloud, persons, witnessed)

    def _people(self, cloud: ColouredCloud, whose: UInt8) -> list[PosedPerson]:
        """Return the people in colour. whose: (h, w), persons found in depth by number, 0 = none.

        Landmarks give a better crop than an outline, so each such crop is found anew.
        """
        assert cloud.rgb is not None
        crops = [cloud.crop(whose == number) for number in np.unique(whose[whose > 0])]
        first = [self._in_wider(cloud.rgb, crop) for crop in crops if crop]
        return people_in(cloud.rgb, self.witness, [person.crop for person in first if person])

    def _in_wider(self, rgb: UInt8, crop: PersonCrop) -> PosedPerson | None:
        """Return the person in a crop or, as of an upper body, in a wider one."""
        each = ((1.0, LEAST), *((k, SURER) for k in WIDENED))
        found = (self.witness.landmark(rgb, crop._replace(side=k * crop.side), least) for k, least in each)
        return next((person for person in found if person), None)

    def _labelled(self, cloud: ColouredCloud, outline: Outline, taken: Bool) -> tuple[Bool, Segmentation]:
        """Return a person's pixels (h, w) and their labels, with its joints. taken: others' pixels."""
        inner, wide = outline.bounds()
        body = witnessed_body(cloud.cloud, outline, wide & ~taken, self.network)
        mask, regions = corrected(cloud.cloud, body, inner, shipped_witness_network())
        chance = in_scheme(regions, self.scheme)
        best = chance[1:].argmax(axis=0) + 1
        parts, sure = np.full(mask.shape, BACKGROUND, np.uint8), np.zeros(mask.shape, np.float32)
        parts[mask], sure[mask] = self.scheme.class_ids[best], chance.max(axis=0)
        bearing = None if body.state is None else _placed(body.state, body.skeleton, cloud, mask).note()
        return mask, Segmentation(parts, sure, bearing=bearing, scheme=self.scheme)

    def label(
        self, detection: ColourDetection, before: FrameLabels | None
    ) -> tuple[Segmentation, PersonMask]:
        """Return the labels and the persons of a frame. before: labels of the previous frame."""
        found = detection.persons.person(before)
        numbers = _numbers([mask for mask, _ in detection.witnessed], found.persons, self.everybody)
        persons, notes = np.zeros_like(found.persons), set[str]()
        results = []
        for number, (mask, labels) in zip(numbers, detection.witnessed, strict=True):
            persons[mask] = number
            if number == 1 or self.everybody:
                results.append((number, labels))
        unseen = (found.persons > 0) & ~np.isin(found.persons, numbers)
        unseen &= persons == 0
        nothing = unlabelled(found.mask & unseen, scheme=self.scheme)
        labels = joined(results, nothing)
        if detection.cloud.rgb is None:
            notes.add(NO_COLOUR)
        elif not results:
            notes.add(NOBODY)
        elif unseen.any():
            notes.add(UNSEEN)
        parts = np.where(unseen & (labels.parts == BACKGROUND), np.uint8(UNDEFINED), labels.parts)
        persons = np.where(unseen, np.maximum(found.persons, 2), persons).astype(np.uint8)
        labels = replace(labels, parts=parts, notes=tuple(sorted(notes)))
        return labels, replace(found, mask=persons == 1, persons=persons, notes=(), trusted=True)


def _numbers(masks: list[Bool], persons: UInt8, everybody: bool) -> list[int]:
    """Return the person ids of witnessed people (h, w): of the person found in depth there, or a new one.

    everybody: False gives the largest person id 1 where no one else has it.
    """
    numbers = list[int]()
    fresh = iter(range(int(persons.max(initial=0)) + 1, 256))
    for mask in masks:
        there = np.bincount(persons[mask], minlength=2)
        there[[0, *numbers]] = 0
        best = int(there.argmax())
        numbers.append(best if there[best] >= SAME * mask.sum() else max(2, next(fresh)))
    if masks and not everybody and 1 not in numbers:
        numbers[int(np.argmax([mask.sum() for mask in masks]))] = 1
    return numbers


def _shown(cloud: ColouredCloud, person: PosedPerson, skeleton: Skeleton) -> dict[str, Any]:
    """Return the note on what the witness shows of a person."""
    mask = None if person.mask is None else np.nan_to_num(cloud.seen(person.mask)) >= 0.5
    return ShownPerson.of(skeleton, mask).note()


def _placed(state: BodyState, skeleton: Skeleton, cloud: ColouredCloud, mask: Bool) -> BodyState:
    """Return the state with the skeleton's joints, and the posture and the facing that follow from them.

    mask: the person's pixels (h, w).
    """
    joints_m, camera = skeleton.body_joints_m(), cloud.cloud.camera
    at = np.column_stack([project(camera, joints_m), 1000 * joints_m[:, 2]])
    known = np.isfinite(at).all(axis=1, keepdims=True)
    joints_px = np.where(known, at, state.joints_px)
    placed = replace(state, joints_px=joints_px, joints_sd=None, joints_seen=None)
    return with_posture(placed, (cloud.depth_mm, mask & (cloud.depth_mm > 0)), camera).faced_by_joints(camera)
