"""Prediction on label sets and datasets by a trained network, inside the persons' given outlines."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial, reduce
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from annotate.array_types import Bool
from annotate.frame_labels import FrameLabels
from annotate.label_recording import Run, check_same, finished
from annotate.labelset.cast_note import cast_note, cast_of
from annotate.labelset.claim import Claim, login
from annotate.labelset.label_set import LabelSet
from annotate.labelset.labelled_frames import LabelledFrames
from annotate.labelset.scheme_note import scheme_note
from annotate.person.planes import Plane
from annotate.scheme.merging import converts
from annotate.scheme.scheme import Scheme
from annotate.segmentation.labels_of_frame import notes_of
from annotate.segmentation.segmented_person import Segmentation
from annotate.segmentation.suit_network import SuitNetwork
from eval.network.body_state import BodyState
from eval.network.finer_parts import in_finer_scheme
from eval.network.onnx_network import OnnxNetwork
from eval.network.posture_model import with_posture
from eval.network.refine import camera_in, in_scheme, refine
from eval.network.sure_parts import keep_sure_parts
from sensors.errors import CloudError, FormatError
from sensors.rig.camera import Intrinsics

BATCH = 8  # frames through the network at once; larger batches gain nothing on a CPU (bench/predict.py)
WRITERS = 4  # frames written at once, because each waits for the disk; untuned


@dataclass(frozen=True)
class PredictOptions:
    """Options of a prediction. Raises CloudError where they exclude each other.

    probabilities: keep the probabilities of all classes. everybody: label all persons, not the subject alone.
    window_c: lowest and highest temperature of persons. room_refiner: network that refines labels where a
    frame shows the room, and deletes no sure part (``keep_sure_parts``). refiners: networks that then refine
    all labels, one after the other, and may delete. scheme: of the labels; None = the usual one of the
    last network. everybody, window_c and room_refiner affect recordings only; batch, frames at once, label
    sets only.
    """

    probabilities: bool = False
    everybody: bool = False
    window_c: tuple[float, float] | None = None
    room_refiner: SuitNetwork | None = None
    refiners: Sequence[SuitNetwork] = ()
    batch: int = BATCH
    scheme: Scheme | None = None

    def __post_init__(self) -> None:
        if self.everybody and self.probabilities:
            raise CloudError(
                "probabilities are of one person, everybody labels all; leave out one of the two"
            )
        if self.all_refiners and (self.everybody or self.probabilities):
            raise CloudError(
                "refinement is of one person; leave out probabilities and everybody, or the refinement"
            )

    @property
    def all_refiners(self) -> list[SuitNetwork]:
        """Return the networks that refine labels, in order of use."""
        return [network for network in (self.room_refiner, *self.refiners) if network]

    def chained(self, network: OnnxNetwork) -> "Networks":
        """Return the networks, each with labels in the scheme that the next one takes.

        Raises FormatError where one of them cannot give the next scheme.
        """
        last = self.refiners[-1] if self.refiners else network
        target = self.scheme or last.usual_scheme
        refiners = self.all_refiners
        if (room := self.room_refiner) and refiners == [room] and not converts(room.own, target):
            for scheme in (room.own, target):
                network.in_scheme(scheme)  # raises FormatError where the network cannot give the scheme
            return Networks(network.in_scheme(network.own), room.in_scheme(room.own), [], target)
        schemes = [*(one.own for one in refiners), target]
        chain = [one.in_scheme(after) for one, after in zip(refiners, schemes[1:], strict=True)]
        refined, rest = (chain[0], chain[1:]) if room else (None, chain)
        return Networks(network.in_scheme(schemes[0]), refined, rest, target)

    def step(self, network: OnnxNetwork) -> dict[str, Any]:
        """Return the entry of a label set's manifest about the networks."""
        step = {"weights": network.sha256, "probabilities": self.probabilities}
        refiners = [refiner.sha256 for refiner in self.all_refiners]
        return step | ({"readers": refiners} if refiners else {})


DEFAULT = PredictOptions()


def fits(options: PredictOptions, network: OnnxNetwork) -> bool:
    """Return whether the networks can give labels in the scheme of the options, one after the other."""
    try:
        options.chained(network)
    except FormatError:
        return False
    return True


@dataclass(frozen=True)
class Networks:
    """Network of the first labels, and the networks that refine them.

    scheme: of the last labels; finer than ``room_refiner.scheme`` only if no other network refines.
    """

    first: OnnxNetwork
    room_refiner: SuitNetwork | None
    refiners: Sequence[SuitNetwork]
    scheme: Scheme

    @property
    def after_room(self) -> Scheme:
        """Return the scheme of the labels after the refinement by the room."""
        return self.refiners[0].own if self.refiners else self.scheme

    def refined_by_room(
        self, camera: Intrinsics, first: FrameLabels, person: Bool, planes: tuple[Plane, ...] | None = None
    ) -> FrameLabels:
        """Return a frame's first labels in ``after_room``, refined where the frame shows a room around its
        person (h, w); unchanged without ``room_refiner``.

        planes: of the room; None = find them from depth.
        """
        room = self.room_refiner
        if room is None:
            return first
        refined = first
        if np.count_nonzero(first.depth_mm) > 2 * np.count_nonzero(person):
            refined = keep_sure_parts(in_scheme(first, room.scheme), refine(camera, first, room, planes))
        return in_finer_scheme(refined, first, self.after_room)


def predict_frames(
    frames: LabelledFrames,
    network: OnnxNetwork,
    out: Path,
    progress: Callable[[int], None],
    options: PredictOptions = DEFAULT,
) -> Run:
    """Label the persons of a label set or a dataset with the network; resume an interrupted run.

    Unreadable frames are left out and listed. Raises ExistsError where ``out`` holds another run,
    ClaimedError while it is in use, CloudError without a usable frame. Raises FormatError for a damaged
    dataset or a scheme that the networks cannot give.
    """
    if not len(frames):
        raise CloudError(f"{frames.path} holds no frames; give a label set or dataset with frames")
    step = {"predict": options.step(network) | frames.identity}
    networks = options.chained(network)
    notes = cast_note(cast_of(frames.info)) | scheme_note(networks.scheme)
    info = {"source": frames.source, "steps": step, **notes}
    predicted = LabelSet.resume(out, frames.intrinsics, info)
    failed: list[tuple[str, str]] = []
    with Claim.take(out, login()):
        todo = _todo(frames, predicted, failed, progress)
        with ThreadPoolExecutor(WRITERS) as writers:
            writing: Iterator[None] = iter(())
            while some := list(islice(todo, options.batch)):
                images = [(frame.depth_mm, frame.on_person) for frame in some]
                cameras = [_camera(frames, frame) if networks.first.has_joints else None for frame in some]
                results = networks.first.segment_all(images, cameras, probabilities=options.probabilities)
                for _ in writing:
                    progress(1)
                writing = writers.map(partial(_write, frames, predicted, networks), some, results)
            for _ in writing:
                progress(1)
        return finished(predicted, failed)


def _camera(frames: LabelledFrames, frame: FrameLabels) -> Intrinsics | None:
    """Return the pinhole camera of a frame; None without a person. Raises FormatError as ``camera_in``."""
    return camera_in(frames, frame) if frame.on_person.any() else None


def check_one_person(frames: LabelledFrames) -> None:
    """Raise CloudError for labels of all persons, because their outlines run together into one person."""
    steps = frames.info.get("steps")
    step = steps.get("predict") if isinstance(steps, dict) else None
    if isinstance(step, dict) and step.get("everybody"):
        raise CloudError(f"{frames.path} labels everybody; give the labels of one person, or the recording")


def _todo(
    frames: LabelledFrames,
    predicted: LabelSet,
    failed: list[tuple[str, str]],
    progress: Callable[[int], None],
) -> Iterator[FrameLabels]:
    """Yield the frames that an earlier run has not labelled.

    failed: receives the id and reason of each unreadable frame.
    """
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
    networks: Networks,
    frame: FrameLabels,
    result: Segmentation,
) -> None:
    notes = notes_of(result)
    if (state := BodyState.from_note(result.bearing)) is not None:
        camera = camera_in(frames, frame)
        state = with_posture(state, (frame.depth_mm, frame.on_person), camera)
        notes["bearing"] = state.faced_by_joints(camera).note()
    notes |= {name: frame.notes[name] for name in ("crop", "intrinsics") if name in frame.notes}
    labelled = replace(
        frame,
        parts=result.parts,
        confidence=result.confidence,
        status="auto",
        notes=notes,
        scheme=result.scheme,
    )
    if networks.room_refiner:
        labelled = in_scheme(labelled, networks.after_room)
    if networks.refiners:
        labelled = reduce(partial(refine, camera_in(frames, labelled)), networks.refiners, labelled)
    predicted.write(labelled, result.probabilities)
