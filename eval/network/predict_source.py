"""Prediction on recordings by a trained network: find the people of every frame, then label them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from pathlib import Path

import numpy as np

from annotate.array_types import Bool
from annotate.cloud.coarse import CoarseCloud, CoarseFuser
from annotate.frame_labels import FrameLabels
from annotate.label_recording import Run, run
from annotate.person.extract import PersonDetection, PersonMask
from annotate.scheme.scheme import Scheme
from annotate.segmentation.segmented_person import Segmentation, unlabelled
from eval.network.body_state import BodyState
from eval.network.joints.joint_filter import filter_joints
from eval.network.onnx_network import OnnxNetwork
from eval.network.posture_model import with_posture
from eval.network.predict import DEFAULT, Networks, PredictOptions
from eval.network.refine import refine
from eval.network.side_smoothing import smooth_sides
from eval.network.support import exclude_standing, floor_of, support_of
from sensors.rig.frame import FrameSource
from sensors.rig.rig_calibration import RigCalibration


def predict_source(
    source: FrameSource,
    network: OnnxNetwork,
    out: Path,
    progress: Callable[[int], None],
    options: PredictOptions = DEFAULT,
) -> Run:
    """Label the person of every frame of a source with the network; resume an interrupted run.

    Raises the errors of ``label_recording.run``, and FormatError for a scheme that the networks cannot give.
    """
    window_c = list(options.window_c) if options.window_c else None
    step = options.step(network) | {"window_c": window_c} | ({"everybody": True} if options.everybody else {})
    return run(source, {"predict": step}, out, NetworkLabeller(network, options), progress)


@dataclass(frozen=True)
class NetworkLabeller:
    """Labeller of coarse clouds (``annotate.label_recording.Labeller``) by a network."""

    network: OnnxNetwork
    options: PredictOptions = DEFAULT

    @cached_property
    def networks(self) -> Networks:
        """Return the networks; the last one labels in ``scheme``."""
        return self.options.chained(self.network)

    @property
    def scheme(self) -> Scheme:
        """Return the scheme of the labels."""
        return self.networks.scheme

    def fuser(self, calibration: RigCalibration) -> CoarseFuser:
        return CoarseFuser(calibration)

    def detect(self, cloud: CoarseCloud) -> "NetworkDetection":
        return NetworkDetection(self, cloud)

    def label(
        self, detection: "NetworkDetection", before: FrameLabels | None
    ) -> tuple[Segmentation, PersonMask]:
        """Return a frame's refined labels and person mask. before: labels of the previous frame."""
        found, person = detection.labels(before)
        if not self.options.all_refiners or not person.mask.any() or not person.trusted:
            return _without_things(replace(found, scheme=self.scheme), person)
        cloud, planes = detection.cloud, detection.planes
        first = FrameLabels(
            "",
            cloud.depth_mm,
            found.parts,
            found.confidence,
            persons=person.persons,
            scheme=found.scheme,
        )
        refined = self.networks.refined_by_room(cloud.camera, first, person.mask, planes)
        refined = reduce(partial(refine, cloud.camera, planes=planes), self.networks.refiners, refined)
        assert refined.confidence is not None and refined.persons is not None
        found = replace(found, parts=refined.parts, confidence=refined.confidence, scheme=refined.scheme)
        return _without_things(found, replace(person, mask=refined.persons == 1, persons=refined.persons))


class NetworkDetection:
    """Frame whose persons are detected and whose likely subject is labelled."""

    def __init__(self, labeller: NetworkLabeller, cloud: CoarseCloud) -> None:
        options = labeller.options
        self._persons = PersonDetection(cloud, options.window_c, everybody=options.everybody)
        self._network, self._options = labeller.networks.first, options
        self.cloud, self.planes = cloud, self._persons.planes
        self._labels: dict[bytes, Segmentation] = {}
        person = self._persons.person()
        if person.trusted:
            for number in self._numbers(person):
                self._labelled(person, number)

    def labels(self, before: FrameLabels | None) -> tuple[Segmentation, PersonMask]:
        """Return the frame's labels and its person mask. before: labels of the previous frame."""
        person = self._persons.person(before)
        if not person.trusted:
            return unlabelled(person.mask, scheme=self._network.scheme), person
        results = [
            (number, self._smoothed(self._labelled(person, number), before, number))
            for number in self._numbers(person)
        ]
        return joined(results, unlabelled(person.mask, scheme=self._network.scheme)), person

    def _smoothed(self, found: Segmentation, before: FrameLabels | None, number: int) -> Segmentation:
        """Return a person's labels with sides and joints smoothed over the recording."""
        sided = smooth_sides(found, before, number)
        return filter_joints(sided, before, self.cloud.camera, self.cloud.cloud.stamp_ns, number)

    def _numbers(self, person: PersonMask) -> list[int]:
        """Return the person ids to label: all ids of the mask, or the subject's 1."""
        return np.unique(person.persons[person.persons > 0]).tolist() if self._options.everybody else [1]

    def _labelled(self, person: PersonMask, number: int) -> Segmentation:
        """Return labels of a person, computed once for each mask."""
        mask = person.mask if number == 1 else person.persons == number
        key = np.packbits(mask).tobytes()
        if key not in self._labels:
            self._labels[key] = self._segmented(mask)
        return self._labels[key]

    def _segmented(self, mask: Bool) -> Segmentation:
        """Return labels of a mask (h, w), with the person's support."""
        coarse = self.cloud
        result = self._network.segment(
            coarse.depth_mm, mask, coarse.camera, probabilities=self._options.probabilities
        )
        state = BodyState.from_note(result.bearing)
        if state is None:
            return result
        parts = np.where(coarse.pixel >= 0, result.parts.ravel()[coarse.pixel], np.uint8(0))
        floor = floor_of(self.planes, coarse.cloud.points_m)
        state = with_posture(state, (coarse.depth_mm, mask), coarse.camera)
        state = exclude_standing(state, coarse.camera, floor)
        support = support_of(state.likeliest, parts, coarse.cloud.points_m, floor, result.scheme)
        state = replace(state, support=support).faced_by_joints(coarse.camera)
        return replace(result, bearing=state.note())


def _without_things(found: Segmentation, person: PersonMask) -> tuple[Segmentation, PersonMask]:
    """Return labels and the person mask without the pixels that are labelled as things."""
    if not found.scheme.is_thing.any() or not (things := found.scheme.is_thing[found.parts]).any():
        return found, person
    persons = np.where(things, np.uint8(0), person.persons)
    return found, replace(person, mask=person.mask & ~things, persons=persons)


def joined(results: Sequence[tuple[int, Segmentation]], empty: Segmentation) -> Segmentation:
    """Return the merged labels of several persons of one image.

    results: person ids with their labels. empty: labels of an image without persons.
    """
    if not results:
        return empty
    if len(results) == 1 and results[0][0] == 1:
        return results[0][1]
    parts = np.maximum.reduce([result.parts for _, result in results])
    confidence = np.maximum.reduce([result.confidence for _, result in results])
    notes = tuple(dict.fromkeys(note for _, result in results for note in result.notes))
    states = {number: result.bearing for number, result in results if result.bearing}
    own = states.pop(1, {})
    others = {"others": {str(n): note for n, note in states.items()}}
    bearing = own | others if own or states else None
    return Segmentation(parts, confidence, notes, bearing=bearing, scheme=empty.scheme)
