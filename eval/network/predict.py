"""A trained network at work: the person's crop in, part labels over the depth image out."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.crop import SIZE, Crop, person_of
from annotate.frame_labels import FrameLabels
from annotate.label_source import Run, check_same, finished, notes_of, run
from annotate.labelset.claim import Claim, login
from annotate.labelset.dataset import MANIFEST, sha256
from annotate.labelset.store import LabelSet
from annotate.person.extract import PersonMask, extract_person
from annotate.segmentation.segment import Segmentation, unlabelled
from eval.network.onnx_network import SHIPPED_WEIGHTS as SHIPPED_WEIGHTS
from eval.network.onnx_network import Network as Network
from eval.scores.frames import Frames
from sensors.errors import CloudError, FormatError
from sensors.rig.camera import Intrinsics
from sensors.rig.kinect2_factory import KINECT2_PINHOLE as CAMERA
from sensors.rig.source import FrameSource

BATCH = 8
"""Frames through the network at once. More are no faster on a CPU; the answers are the same bytes for any."""
WRITERS = 4
"""Frames written at once: each waits for the disk most of the time."""


def predict_source(
    source: FrameSource,
    network: Network,
    out: Path,
    progress: Callable[[int], None],
    window_c: tuple[float, float] | None = None,
    *,
    probabilities: bool = False,
) -> Run:
    """Extract the person of every frame of a source and label it by the network; resumes.

    What lies on the person and was extracted with them by its warmth, a blanket or a laptop, the network
    takes off again.
    Each extraction starts from the frame before, so frames go one by one. Raises what ``label.run`` raises.
    """

    def one(cloud: ThermalCloud, before: FrameLabels | None) -> tuple[Segmentation, PersonMask]:
        person = extract_person(cloud, window_c, before)
        if not person.trusted:
            return unlabelled(person.mask), person
        # A first look finds the things that were taken along, a second one labels who is left without them.
        # Where depth alone found the person nothing is: there real trousers were taken for a blanket.
        if person.method != "depth":
            person = replace(person, mask=network.without_things(cloud.depth_mm, person.mask))
        return network.segment(cloud.depth_mm, person.mask, probabilities=probabilities), person

    step = _step(network, probabilities) | {"window_c": list(window_c) if window_c else None}
    return run(source, {"predict": step}, out, one, progress)


def predict_frames(
    frames: Frames,
    network: Network,
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
    step = _step(network, probabilities)
    if isinstance(frames, LabelSet):
        camera, source = frames.intrinsics, frames.info.get("source", "")
    else:
        camera, source = _camera_of_crops(), frames.path.resolve().name
        step["dataset"] = sha256(frames.path / MANIFEST)
    predicted = LabelSet.resume(out, camera, {"source": source, "steps": {"predict": step}})
    with Claim.take(out, login()):
        return finished(predicted, _predict(frames, network, predicted, progress, probabilities, batch))


def _predict(
    frames: Frames,
    network: Network,
    predicted: LabelSet,
    progress: Callable[[int], None],
    probabilities: bool,
    batch: int,
) -> list[tuple[str, str]]:
    """Label the frames that are not done yet; (frame id, why) of those that failed."""
    failed: list[tuple[str, str]] = []
    todo = _todo(frames, predicted, failed, progress)
    with ThreadPoolExecutor(WRITERS) as writers:
        writing: list[Future[None]] = []
        while some := list(islice(todo, batch)):
            results = network.segment_all(
                [(frame.depth_mm, person_of(frame.parts)) for frame in some], probabilities=probabilities
            )
            _wait(writing, progress)
            writing = [writers.submit(_write, predicted, *pair) for pair in zip(some, results, strict=True)]
        _wait(writing, progress)
    return failed


def _step(network: Network, probabilities: bool) -> dict[str, Any]:
    return {"weights": network.sha256, "probabilities": probabilities}


def _camera_of_crops() -> Intrinsics:
    """The label set of a dataset's crops needs a camera: the middle of the image. Each crop's own place is
    in its frame's notes."""
    return Crop((CAMERA.height - SIZE) // 2, (CAMERA.width - SIZE) // 2, SIZE).camera(CAMERA)


def _todo(
    frames: Frames, predicted: LabelSet, failed: list[tuple[str, str]], progress: Callable[[int], None]
) -> Iterator[FrameLabels]:
    """Frames not done by an earlier run; notes those that cannot be read."""
    done = set(predicted.frame_ids)
    for frame in _readable(frames, failed, progress):
        if frame.frame_id in done:
            check_same(predicted, frame.frame_id, frame.depth_mm)
            progress(1)
        else:
            yield frame


def _readable(
    frames: Frames, failed: list[tuple[str, str]], progress: Callable[[int], None]
) -> Iterator[FrameLabels]:
    if not isinstance(frames, LabelSet):
        yield from frames
        return
    for frame_id in frames.frame_ids:
        try:
            frame = frames.read(frame_id)
        except FormatError as error:
            failed.append((frame_id, str(error)))
            progress(1)
        else:
            yield frame


def _wait(writing: Sequence[Future[None]], progress: Callable[[int], None]) -> None:
    for written in writing:
        written.result()
        progress(1)


def _write(predicted: LabelSet, frame: FrameLabels, result: Segmentation) -> None:
    notes = notes_of(result)
    if "crop" in frame.notes:
        notes["crop"] = frame.notes["crop"]
    labelled = FrameLabels(
        frame.frame_id,
        frame.depth_mm,
        result.parts,
        result.confidence,
        subject=frame.subject,
        notes=notes,
        persons=frame.persons,
    )
    predicted.write(labelled, result.probabilities)
