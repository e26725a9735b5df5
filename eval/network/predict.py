"""A trained network at work: the person's crop in, part labels over the depth image out."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from annotate.array_types import Bool
from annotate.crop import person_of
from annotate.frame_labels import FrameLabels
from annotate.label_source import Labeller, Run, check_same, finished, notes_of, run
from annotate.labelset.claim import Claim, login
from annotate.labelset.frames import LabelledFrames
from annotate.labelset.store import LabelSet
from annotate.person.extract import PersonMask, Survey
from annotate.segmentation.segment import Segmentation, unlabelled
from eval.network.onnx_network import OnnxNetwork
from eval.network.steady import steady
from sensors.errors import CloudError, FormatError
from sensors.rig.frame import FrameSource

BATCH = 8
"""Frames through the network at once: more are no faster on a CPU (measured by bench/predict.py). The labels
are the same bytes for any number."""
WRITERS = 4
"""Frames written at once: each waits for the disk most of the time; chosen by eye."""


def predict_source(
    source: FrameSource,
    network: OnnxNetwork,
    out: Path,
    progress: Callable[[int], None],
    window_c: tuple[float, float] | None = None,
    *,
    things: OnnxNetwork | None = None,
    probabilities: bool = False,
    everybody: bool = False,
) -> Run:
    """Extract the person of every frame of a source and label it by the network; resumes.

    What lies on the person and was extracted with them by its warmth, a blanket or a laptop, the network
    ``things`` takes off again, by default the same one. everybody: label all persons, not the subject alone.
    Each extraction starts from the frame before, so frames go one by one. Raises what ``label.run`` raises;
    CloudError for the probabilities of everybody.
    """
    if everybody and probabilities:
        raise CloudError("probabilities are kept of one person; leave --probabilities or --everybody out")

    step = _step(network, probabilities) | {"window_c": list(window_c) if window_c else None}
    step |= {"things": things.sha256} if things else {}
    step |= {"everybody": True} if everybody else {}
    survey = partial(Survey, window_c=window_c, everybody=everybody)
    labeller = network_labeller(network, things, probabilities=probabilities, everybody=everybody)
    return run(source, {"predict": step}, out, labeller, progress, survey)


def network_labeller(
    network: OnnxNetwork,
    things: OnnxNetwork | None = None,
    *,
    probabilities: bool = False,
    everybody: bool = False,
) -> Labeller:
    """Labeller of surveys by a network; arguments as of ``predict_source``."""

    def one(survey: Survey, before: FrameLabels | None) -> tuple[Segmentation, PersonMask]:
        person, depth_mm = survey.person(before), survey.cloud.depth_mm
        if not person.trusted:
            return unlabelled(person.mask), person
        numbers = np.unique(person.persons[person.persons > 0]) if everybody else [1]
        masks = [person.mask if number == 1 else person.persons == number for number in numbers]
        # A first look finds the things that were taken along, a second one labels who is left without them.
        # Where depth alone found the person nothing is: there real trousers were taken for a blanket.
        if person.method != "depth":
            masks = [(things or network).without_things(depth_mm, mask) for mask in masks]
        results = network.segment_all([(depth_mm, mask) for mask in masks], probabilities=probabilities)
        if not everybody:
            return steady(results[0], before), replace(person, mask=masks[0])
        whose = np.zeros_like(person.persons)
        for number, mask in zip(numbers, masks, strict=True):
            whose[mask] = number
        return _together(results, person.mask), replace(person, mask=whose == 1, persons=whose)

    return one


def _together(results: Sequence[Segmentation], nobody: Bool) -> Segmentation:
    """Labels of several persons of one image; nobody: a mask (h, w) for where there are none."""
    if not results:
        return unlabelled(nobody)
    parts = np.maximum.reduce([result.parts for result in results])
    confidence = np.maximum.reduce([result.confidence for result in results])
    notes = tuple(dict.fromkeys(note for result in results for note in result.notes))
    return Segmentation(parts, confidence, notes)


def predict_frames(
    frames: LabelledFrames,
    network: OnnxNetwork,
    out: Path,
    progress: Callable[[int], None],
    *,
    probabilities: bool = False,
    batch: int = BATCH,
) -> Run:
    """Label the persons of a label set or a dataset by the network, within the same outlines; resumes.

    Frames that cannot be read are left out and listed. Raises ExistsError when ``out`` holds something else
    than the beginning of this very run, ClaimedError while somebody else writes it, CloudError when there is
    no frame, or none that can be done; FormatError where a dataset breaks off.
    """
    if not len(frames):
        raise CloudError(f"{frames.path} holds no frames; give a label set or dataset with frames")
    step = _step(network, probabilities) | frames.identity
    info = {"source": frames.source, "steps": {"predict": step}}
    predicted = LabelSet.resume(out, frames.intrinsics, info)
    with Claim.take(out, login()):
        return finished(predicted, _predict(frames, network, predicted, progress, probabilities, batch))


def _predict(
    frames: LabelledFrames,
    network: OnnxNetwork,
    predicted: LabelSet,
    progress: Callable[[int], None],
    probabilities: bool,
    batch: int,
) -> list[tuple[str, str]]:
    """Label the frames that are not done yet; (frame id, why) of those that failed."""
    failed: list[tuple[str, str]] = []
    todo = _todo(frames, predicted, failed, progress)
    with ThreadPoolExecutor(WRITERS) as writers:
        writing: Iterator[None] = iter(())
        while some := list(islice(todo, batch)):
            images = [(frame.depth_mm, person_of(frame.parts)) for frame in some]
            results = network.segment_all(images, probabilities=probabilities)
            for _ in writing:
                progress(1)
            writing = writers.map(partial(_write, predicted), some, results)
        for _ in writing:
            progress(1)
    return failed


def _step(network: OnnxNetwork, probabilities: bool) -> dict[str, Any]:
    return {"weights": network.sha256, "probabilities": probabilities}


def _todo(
    frames: LabelledFrames,
    predicted: LabelSet,
    failed: list[tuple[str, str]],
    progress: Callable[[int], None],
) -> Iterator[FrameLabels]:
    """Frames not done by an earlier run; notes those that cannot be read."""
    done = set(predicted.frame_ids)
    for entry in frames.entries():
        try:
            frame = frames.load(entry)
        except FormatError as error:
            failed.append((entry.frame_id, str(error)))
            progress(1)
            continue
        if frame.frame_id in done:
            check_same(predicted, frame.frame_id, frame.depth_mm)
            progress(1)
        else:
            yield frame


def _write(predicted: LabelSet, frame: FrameLabels, result: Segmentation) -> None:
    notes = notes_of(result)
    notes |= {name: frame.notes[name] for name in ("crop", "intrinsics") if name in frame.notes}
    labelled = replace(frame, parts=result.parts, confidence=result.confidence, status="auto", notes=notes)
    predicted.write(labelled, result.probabilities)
