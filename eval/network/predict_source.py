"""Prediction on recordings by a trained network: the people of every frame are found, then labelled."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from pathlib import Path

import numpy as np

from annotate.array_types import Bool, UInt16
from annotate.cloud.coarse import CoarseCloud, CoarseFuser
from annotate.frame_labels import FrameLabels
from annotate.label_recording import Run, run
from annotate.person.extract import PersonDetection, PersonMask
from annotate.segmentation.segmented_person import Segmentation, unlabelled
from annotate.segmentation.suit_network import SuitNetwork
from eval.network.body_state import Bearing
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict import ONE_PERSON, step_of
from eval.network.refine import read_again
from eval.network.side_smoothing import steady
from eval.network.support import by_height, floor_of, support_of
from sensors.errors import CloudError
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FrameSource
from sensors.rig.rig_calibration import RigCalibration


def predict_source(
    source: FrameSource,
    network: OnnxNetwork,
    out: Path,
    progress: Callable[[int], None],
    window_c: tuple[float, float] | None = None,
    *,
    probabilities: bool = False,
    everybody: bool = False,
    again: SuitNetwork | None = None,
    readers: Sequence[SuitNetwork] = (),
) -> Run:
    """Extract the person of every frame of a source and label it by the network; resumes.

    everybody: label all persons, not the subject alone. again: reads the labels again where a frame shows the
    room. readers: what reads them again everywhere, in turn. Raises what ``label_recording.run`` raises;
    CloudError where these do not go together.
    """
    if everybody and probabilities:
        raise CloudError("probabilities are kept of one person; leave --probabilities or --everybody out")
    every = [reader for reader in (again, *readers) if reader]
    if every and (everybody or probabilities):
        raise CloudError(ONE_PERSON)
    camera = source.calibration.depth.undistorted()

    step = step_of(network, probabilities, every) | {"window_c": list(window_c) if window_c else None}
    step |= {"everybody": True} if everybody else {}
    detect = partial(
        NetworkSurvey, network=network, window_c=window_c, probabilities=probabilities, everybody=everybody
    )
    label = partial(_labels_again, again, readers, camera) if every else NetworkSurvey.labels
    return run(source, {"predict": step}, out, _NetworkLabeller(detect, label), progress)


@dataclass(frozen=True)
class _NetworkLabeller:
    """Labeller of coarse clouds (``annotate.label_recording.Labeller``)."""

    detect: Callable[[CoarseCloud], "NetworkSurvey"]
    label: Callable[["NetworkSurvey", FrameLabels | None], tuple[Segmentation, PersonMask]]

    def fuser(self, calibration: RigCalibration) -> CoarseFuser:
        return CoarseFuser(calibration)


class NetworkSurvey:
    """A surveyed frame with its likely subject labelled: all the work that needs no other frame.

    Arguments as of ``predict_source``; single_pass: as of ``PersonDetection``.
    """

    def __init__(
        self,
        cloud: CoarseCloud,
        network: OnnxNetwork,
        window_c: tuple[float, float] | None = None,
        *,
        probabilities: bool = False,
        everybody: bool = False,
        single_pass: bool = False,
    ) -> None:
        self._survey = survey = PersonDetection(cloud, window_c, everybody=everybody, single_pass=single_pass)
        self._network, self._probabilities, self._everybody = network, probabilities, everybody
        self.depth_mm, self.planes = cloud.depth_mm, survey.planes
        self._known: dict[bytes, Segmentation] = {}
        person = survey.person()
        if person.trusted:
            for number in self._numbers(person):
                self._labelled(person, number)

    def labels(self, before: FrameLabels | None) -> tuple[Segmentation, PersonMask]:
        """Labels of the frame and its mask; before: labels of the previous frame."""
        person = self._survey.person(before)
        if not person.trusted:
            return unlabelled(person.mask), person
        results = [
            (number, steady(self._labelled(person, number), before, number))
            for number in self._numbers(person)
        ]
        return _together(results, person.mask), person

    def _numbers(self, person: PersonMask) -> list[int]:
        """The persons to label."""
        return np.unique(person.persons[person.persons > 0]).tolist() if self._everybody else [1]

    def _labelled(self, person: PersonMask, number: int) -> Segmentation:
        """Labels of a person, remembered."""
        mask = person.mask if number == 1 else person.persons == number
        key = np.packbits(mask).tobytes()
        if key not in self._known:
            self._known[key] = self._looked(mask)
        return self._known[key]

    def _looked(self, mask: Bool) -> Segmentation:
        """Labels of a mask (h, w), with what the person lies or sits on."""
        coarse = self._survey.cloud
        result = self._network.segment(coarse.depth_mm, mask, probabilities=self._probabilities)
        bearing = Bearing.from_note(result.bearing)
        if bearing is None:
            return result
        parts = np.where(coarse.pixel >= 0, result.parts.ravel()[coarse.pixel], np.uint8(0))
        floor = floor_of(self.planes, coarse.cloud.points_m)
        bearing = by_height(bearing, coarse.camera, floor)
        support = support_of(bearing.name, parts, coarse.cloud.points_m, floor)
        bearing = replace(bearing, support=support).seen_by(coarse.camera)
        return replace(result, bearing=bearing.note())


def _labels_again(
    again: SuitNetwork | None,
    readers: Sequence[SuitNetwork],
    camera: Intrinsics,
    survey: NetworkSurvey,
    before: FrameLabels | None,
) -> tuple[Segmentation, PersonMask]:
    """Labels of a frame and its mask by the network, read again."""
    found, person = survey.labels(before)
    if not person.mask.any() or not person.trusted:
        return found, person
    first = FrameLabels("", survey.depth_mm, found.parts, found.confidence, persons=person.persons)
    if again and _shows_more(survey.depth_mm, person.mask):
        readers = again, *readers
    reread = partial(read_again, camera, planes=survey.planes)
    read = reduce(reread, readers, first)
    assert read.confidence is not None and read.persons is not None
    found = replace(found, parts=read.parts, confidence=read.confidence)
    return found, replace(person, mask=read.persons == 1, persons=read.persons)


def _shows_more(depth_mm: UInt16, person: Bool) -> bool:
    """Whether a depth image (h, w) shows more than its person (h, w): one cut out has no room around."""
    return int(np.count_nonzero(depth_mm)) > 2 * int(np.count_nonzero(person))


def _together(results: Sequence[tuple[int, Segmentation]], nobody: Bool) -> Segmentation:
    """Labels of the numbered persons of one image; nobody: a mask (h, w) for where there are none."""
    if not results:
        return unlabelled(nobody)
    if len(results) == 1 and results[0][0] == 1:
        return results[0][1]
    parts = np.maximum.reduce([result.parts for _, result in results])
    confidence = np.maximum.reduce([result.confidence for _, result in results])
    notes = tuple(dict.fromkeys(note for _, result in results for note in result.notes))
    bearings = {number: result.bearing for number, result in results if result.bearing}
    own = bearings.pop(1, {})
    return Segmentation(
        parts,
        confidence,
        notes,
        bearing=own | {"others": {str(n): note for n, note in bearings.items()}} if own or bearings else None,
    )
