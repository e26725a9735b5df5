"""Labelled people of recordings as crops of the depth network, outlined as prediction outlines them.

A pixel keeps its label with the probability of its confidence, so that the loss and the scores weigh labels
by confidence. A frame that a person has accepted counts as sure; a rejected frame is left out.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt8, UInt16
from annotate.cloud.coarse import CoarseFuser
from annotate.correction.correction import Correction
from annotate.frame_labels import FrameLabels
from annotate.labelset.cast_note import check_trainable
from annotate.labelset.label_set import LabelSet
from annotate.person.extract import PersonDetection
from annotate.scheme.scheme import BACKGROUND, UNDEFINED
from annotate.witness.shown_person import NOTE, ShownPerson
from eval.network.body_state import BodyState, body_state_notes
from eval.network.refine import camera_in
from eval.scores.joint_errors import noted_joints_mm
from eval.scores.joints import IN_SKELETON, JOINT, N_JOINTS
from eval.training.body_targets import JOINTS, no_targets, with_joints
from eval.training.crops import DEPTH_STEPS, person_crop
from eval.training.shared_bodies import bodies_in
from sensors.errors import CloudError
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import RigCalibration
from synth.random_stream import stream

MOST_FRAMES = 480  # of all recordings, evenly spread; detection takes 0.3 s each on one core
LEAST_IOU = 0.5  # of a detected outline and a labelled person; untuned
MOVED_MM = 20.0  # from the witness's joint to the labels' joint, as of a head by depth; untuned
BETWEEN = [JOINT["neck"], JOINT["pelvis"]]
"""Joints that are middles of landmarks to a witness: its neck is 0.19 trunks below the skeleton's, its pelvis
0.05 (64 development images)."""


class LabelledPerson(NamedTuple):
    """Person of a frame: depth uint16 and parts uint8, both (212, 212), and the row of ``body_targets``.

    bodies: by ``eval.training.shared_bodies``. recording: index of the label set. place: of the frame in its
    recording, 0 to 1. number: of the person in the frame. outline: the detected pixels, as packed bits.
    """

    depth: UInt16
    parts: UInt8
    row: Float32
    bodies: frozenset[str]
    recording: int
    place: float
    frame_id: str = ""
    number: int = 1
    outline: UInt8 | None = None


class PersonImage(NamedTuple):
    """Image (h, w) of a labelled person: depth, detected outline, parts; other people are undefined."""

    camera: Intrinsics
    depth_mm: UInt16
    mask: Bool
    parts: UInt8


class TaughtFrames(NamedTuple):
    """Label set and its frames with usable labels.

    places: of these frames in the recording, 0 to 1, by id. sure: ids of frames that a person accepted, and
    of true labels.
    """

    labels: LabelSet
    places: dict[str, float]
    sure: frozenset[str]


def taught_frames(path: Path) -> TaughtFrames:
    """Return the usable frames of a label set: accepted ones, and automatic ones by suit or by colour.

    Raises CloudError for a set without usable frames, and for people who are reserved for measuring.
    """
    with Correction.open(path, read_only=True) as correction:
        labels = correction.labels
        states = {frame_id: correction.state(frame_id) for frame_id in labels.frame_ids}
    check_trainable(path, labels.info)
    sure = frozenset(i for i, state in states.items() if state in ("accepted", "reviewed"))
    witnessed = not steps_of(labels).keys() & {"predict"}
    used = {
        frame_id: n / len(states)
        for n, (frame_id, state) in enumerate(states.items())
        if frame_id in sure or (witnessed and state != "rejected")
    }
    if not used:
        why = "accept frames with fix, or label the recording by suit or colour"
        raise CloudError(f"{path} has 0 of {len(states)} frames to adapt with; {why}")
    return TaughtFrames(labels, used, sure)


def steps_of(labels: LabelSet) -> dict[str, Any]:
    """Return the entry of a label set's manifest about its makers."""
    steps = labels.info.get("steps")
    return steps if isinstance(steps, dict) else {}


def chosen_frames(sets: Sequence[TaughtFrames]) -> list[tuple[int, str]]:
    """Return at most ``MOST_FRAMES`` frames of label sets, evenly spread: index of the set, and id."""
    every = [(n, frame_id) for n, taught in enumerate(sets) for frame_id in taught.places]
    spread = np.linspace(0, len(every) - 1, min(len(every), MOST_FRAMES)).astype(int)
    return [every[i] for i in spread.tolist()]


def people_in(taught: TaughtFrames, recording: int, frame_id: str) -> Iterator[LabelledPerson]:
    """Yield the labelled people of a frame."""
    labels = taught.labels
    frame = _weighed(labels.read(frame_id), frame_id in taught.sure)
    bodies, camera = bodies_in(labels, frame), camera_in(labels, frame)
    for number, own in _labelled_persons(frame):
        mask = detected_outline(camera, frame.depth_mm, own)
        there = mask & ((frame.persons == number) if frame.persons is not None else own)
        if not (there & frame.on_body).any():
            continue
        named = np.where(mask & (there | (frame.parts == UNDEFINED)), frame.parts, np.uint8(BACKGROUND))
        depth, parts = person_crop(frame.depth_mm, mask, named)
        row = targets_of(labels, frame, number, (camera, mask))
        packed = np.rint(depth * DEPTH_STEPS).astype(np.uint16)
        place, outline = taught.places[frame_id], np.packbits(mask)
        yield LabelledPerson(packed, parts, row, bodies, recording, place, frame_id, number, outline)


def image_of(taught: TaughtFrames, person: LabelledPerson) -> PersonImage:
    """Return the image of a person of a label set, from ``people_in``."""
    labels, frame_id = taught.labels, person.frame_id
    frame = _weighed(labels.read(frame_id), frame_id in taught.sure)
    assert person.outline is not None
    mask = np.unpackbits(person.outline, count=frame.parts.size).reshape(frame.parts.shape) > 0
    other = frame.on_person & (frame.persons != person.number) if frame.persons is not None else False
    parts = np.where(other, np.uint8(UNDEFINED), frame.parts)
    return PersonImage(camera_in(labels, frame), frame.depth_mm, mask, parts)


def _weighed(frame: FrameLabels, sure: bool) -> FrameLabels:
    """Return a frame's labels, where a pixel of the body is undefined with the probability of its doubt."""
    if sure or frame.confidence is None:
        return frame
    drawn = stream(0, "confidence", crc32(frame.frame_id.encode())).random(frame.parts.shape, np.float32)
    doubted = frame.on_body & (drawn >= frame.confidence)
    return replace(frame, parts=np.where(doubted, np.uint8(UNDEFINED), frame.parts))


def _labelled_persons(frame: FrameLabels) -> Iterator[tuple[int, Bool]]:
    """Yield the number and the pixels (h, w) of each person with labelled parts."""
    seen = frame.on_person & (frame.depth_mm > 0)
    whose = seen.astype(np.uint8) if frame.persons is None else np.where(seen, frame.persons, np.uint8(0))
    for number in np.unique(whose[whose > 0]).tolist():
        own = whose == number
        if (own & frame.on_body).any():
            yield number, own


def detected_outline(camera: Intrinsics, depth_mm: UInt16, own: Bool) -> Bool:
    """Return the detected person (h, w) that covers a labelled one, or the labelled one without such."""
    cloud = _fuser(camera).fuse(depth_mm)
    persons = PersonDetection(cloud, everybody=True).person().persons
    counts = np.bincount(persons[own], minlength=2)
    counts[0] = 0
    found = (persons == counts.argmax()) & (depth_mm > 0)
    same = int(np.count_nonzero(found & own)) / max(1, int(np.count_nonzero(found | own)))
    return found if counts.any() and same >= LEAST_IOU else own


@lru_cache(maxsize=2)
def _fuser(camera: Intrinsics) -> CoarseFuser:
    return CoarseFuser(RigCalibration(camera))


def targets_of(labels: LabelSet, frame: FrameLabels, number: int, image: tuple[Intrinsics, Bool]) -> Float32:
    """Return a person's row of targets, by joints of a rig or of a witness; unknown without.

    A witness shows places in the image, and its joints in ``BETWEEN`` are other points of the body. image:
    camera, and the pixels (h, w) of the crop's person.
    """
    (camera, mask), row = image, no_targets()
    known = noted_joints_mm(frame)
    if number == 1 and known is not None:
        return with_joints(row, known[IN_SKELETON], camera, (frame.depth_mm, mask))
    joints_mm = witnessed_joints(frame, number, camera) if "label_by_colour" in steps_of(labels) else None
    if joints_mm is None:
        return row
    row = with_joints(row, joints_mm, camera, (frame.depth_mm, mask))
    joints = row[JOINTS].reshape(N_JOINTS, 3)
    joints[BETWEEN], joints[:, 2] = np.nan, np.nan
    return row


def witnessed_joints(frame: FrameLabels, number: int, camera: Intrinsics) -> Float64 | None:
    """Return a person's joints (15, 3), millimetres, where the witness shows them; None without a witness.

    NaN = unknown: hidden joints, and joints that the labels place elsewhere.
    """
    note = body_state_notes(frame.notes).get(number)
    state = BodyState.from_note(note)
    shown = ShownPerson.from_note(note.get(NOTE)) if isinstance(note, dict) else None
    if state is None or shown is None:
        return None
    joints_mm = shown.joints_mm[:N_JOINTS].copy()
    moved_mm = np.linalg.norm(joints_mm - state.joints_mm(camera), axis=1)
    joints_mm[~(moved_mm < MOVED_MM)] = np.nan
    return joints_mm


def check_sets(sets: Sequence[TaughtFrames]) -> None:
    """Raise CloudError where label sets have several schemes, or where one is given twice: its frames would
    be taught and held out.
    """
    first, given = sets[0].labels, set[Path]()
    for labels in (taught.labels for taught in sets):
        if (path := labels.path.resolve()) in given:
            raise CloudError(f"{labels.path} is given twice; give each label set once")
        given.add(path)
    for labels in (taught.labels for taught in sets[1:]):
        if labels.scheme != first.scheme:
            raise CloudError(
                f"{labels.path} has scheme {labels.scheme.name!r}, {first.path} has {first.scheme.name!r}; "
                "convert the labels to one scheme"
            )
