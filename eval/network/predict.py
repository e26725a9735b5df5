"""Prediction on label sets and datasets by a trained network; the person's outlines stay as they are."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial, reduce
from itertools import islice
from pathlib import Path
from typing import Any

from annotate.crop import person_of
from annotate.frame_labels import FrameLabels
from annotate.label_recording import Run, check_same, finished, notes_of
from annotate.labelset.claim import Claim, login
from annotate.labelset.label_set import LabelSet
from annotate.labelset.labelled_frames import LabelledFrames
from annotate.segmentation.segmented_person import Segmentation
from annotate.segmentation.suit_network import SuitNetwork
from eval.network.body_state import Bearing
from eval.network.onnx_network import OnnxNetwork
from eval.network.refine import camera_in, read_again
from sensors.errors import CloudError, FormatError

BATCH = 8
"""Frames through the network at once: more are no faster on a CPU (measured by bench/predict.py). The labels
are the same bytes for any number."""
ONE_PERSON = "one person is read again, and the labels then differ from the probabilities; leave one out"
"""Refusal of what does not go together."""
WRITERS = 4
"""Frames written at once: each waits for the disk most of the time; chosen by eye."""


def predict_frames(
    frames: LabelledFrames,
    network: OnnxNetwork,
    out: Path,
    progress: Callable[[int], None],
    *,
    probabilities: bool = False,
    batch: int = BATCH,
    readers: Sequence[SuitNetwork] = (),
) -> Run:
    """Label the persons of a label set or a dataset by the network, within the same outlines; resumes.

    readers: what reads the labels again, outlines too, in turn. Frames that cannot be read are left out and
    listed. Raises ExistsError when ``out`` holds something else than the beginning of this very run,
    ClaimedError while somebody else writes it, CloudError when there is no frame, or none that can be done;
    FormatError where a dataset breaks off.
    """
    if not len(frames):
        raise CloudError(f"{frames.path} holds no frames; give a label set or dataset with frames")
    if readers and probabilities:
        raise CloudError(ONE_PERSON)
    step = step_of(network, probabilities, readers) | frames.identity
    info = {"source": frames.source, "steps": {"predict": step}}
    predicted = LabelSet.resume(out, frames.intrinsics, info)
    with Claim.take(out, login()):
        return finished(
            predicted, _predict(frames, network, predicted, progress, probabilities, batch, readers)
        )


def _predict(
    frames: LabelledFrames,
    network: OnnxNetwork,
    predicted: LabelSet,
    progress: Callable[[int], None],
    probabilities: bool,
    batch: int,
    readers: Sequence[SuitNetwork],
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
            writing = writers.map(partial(_write, frames, predicted, readers), some, results)
        for _ in writing:
            progress(1)
    return failed


def check_alone(frames: LabelledFrames) -> None:
    """Raise CloudError where labels are of everybody: their outlines run together into one person."""
    steps = frames.info.get("steps")
    step = steps.get("predict") if isinstance(steps, dict) else None
    if isinstance(step, dict) and step.get("everybody"):
        raise CloudError(f"{frames.path} labels everybody; give the labels of one person, or the recording")


def step_of(network: OnnxNetwork, probabilities: bool, readers: Sequence[SuitNetwork] = ()) -> dict[str, Any]:
    """Entry of a label set's manifest about what labels it."""
    again = {"readers": [reader.sha256 for reader in readers]} if readers else {}
    return {"weights": network.sha256, "probabilities": probabilities} | again


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


def _write(
    frames: LabelledFrames,
    predicted: LabelSet,
    readers: Sequence[SuitNetwork],
    frame: FrameLabels,
    result: Segmentation,
) -> None:
    notes = notes_of(result)
    if (bearing := Bearing.from_note(result.bearing)) is not None:
        notes["bearing"] = bearing.seen_by(camera_in(frames, frame)).note()
    notes |= {name: frame.notes[name] for name in ("crop", "intrinsics") if name in frame.notes}
    labelled = replace(frame, parts=result.parts, confidence=result.confidence, status="auto", notes=notes)
    if readers:
        labelled = reduce(partial(read_again, camera_in(frames, labelled)), readers, labelled)
    predicted.write(labelled, result.probabilities)
