"""Frames of a prediction beside those of the truth, counted one after the other or on all cores."""

import hashlib
import os
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from sys import intern

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Int32
from annotate.frame_labels import FrameLabels
from annotate.labelset.frames import Entry, LabelledFrames, camera_of, pinhole_of
from eval.scores.counts import WIDTH, count
from eval.scores.joint_errors import OBSERVED, Observed, observe
from eval.scores.traits import Traits, traits_of
from sensors.errors import CloudError, FormatError
from sensors.rig.camera import Intrinsics
from synth.images.workers import processes

CHUNK = 64
"""Frames that a worker counts in one go."""
WORTH_WORKERS = 400
"""Fewer frames are counted sooner than worker processes have started."""


@dataclass(frozen=True, slots=True)
class Pair:
    """Where a frame's prediction and its truth lie."""

    predicted: Entry
    truth: Entry


@dataclass(frozen=True, slots=True)
class Digests:
    """What tells whether two results are of the same frame: hashes (64 bit, hex) of its three images."""

    depth: str
    truth: str
    predicted: str


@dataclass(frozen=True)
class Counted:
    """Frames and what is known of each: who is seen, traits, digests, counts and joints.

    counts: int32 (F, WIDTH), see ``FrameCounts.flat``. joints: OBSERVED (F,), what the labels show of them.
    """

    frame_ids: list[str]
    subjects: list[str]
    traits: list[Traits]
    digests: list[Digests]
    counts: Int32
    joints: Observed

    @staticmethod
    def room(frames: int) -> "Counted":
        """Of no frame yet, with zeros in the arrays of so many."""
        return Counted([], [], [], [], np.zeros((frames, WIDTH), np.int32), np.zeros(frames, OBSERVED))

    def put(self, some: "Counted") -> None:
        """Add frames behind those that are there."""
        rows = slice(len(self.frame_ids), len(self.frame_ids) + len(some.frame_ids))
        self.counts[rows], self.joints[rows] = some.counts, some.joints
        for name in ("frame_ids", "subjects", "traits", "digests"):
            getattr(self, name).extend(getattr(some, name))


def pair_up(predicted: LabelledFrames, truth: LabelledFrames) -> tuple[list[Pair], int]:
    """Each frame of the truth with the prediction of the same id, and how many predictions are left over.

    Raises CloudError where the truth has no frame, or the prediction lacks one: leaving out what failed
    would flatter the score. Raises FormatError where a dataset has a frame twice or cannot be read.
    """
    known, wanted = _entries(predicted), _entries(truth)
    if not wanted:
        raise CloudError(f"{truth.path} holds no frames; give a label set or dataset with frames")
    missing = [frame_id for frame_id in wanted if frame_id not in known]
    if missing:
        raise CloudError(
            f"{predicted.path} lacks {len(missing)} of the {len(wanted)} frames of {truth.path}, "
            f"first {missing[0]}; predict or label them, or take them out of the truth"
        )
    return [Pair(known[i], entry) for i, entry in wanted.items()], len(known) - len(wanted)


def _entries(frames: LabelledFrames) -> dict[str, Entry]:
    """Entries by frame id, in order."""
    entries: dict[str, Entry] = {}
    for entry in frames.entries():
        if entry.frame_id in entries:
            raise FormatError(f"{frames.path} holds frame {entry.frame_id!r} twice; generate it again")
        entries[entry.frame_id] = entry
    return entries


def count_pairs(
    predicted: LabelledFrames,
    truth: LabelledFrames,
    pairs: Sequence[Pair],
    advance: Callable[[int], None],
    workers: int | None = None,
) -> Counted:
    """Count every pair, in order. advance: told how many more are done. workers: processes to use.

    Raises CloudError naming a frame whose two sides do not belong together, FormatError for a corrupt one.
    """
    if workers is None:
        workers = len(os.sched_getaffinity(0)) if len(pairs) >= WORTH_WORKERS else 1
    chunks = [pairs[i : i + CHUNK] for i in range(0, len(pairs), CHUNK)]
    work = partial(_count_chunk, predicted, truth)
    with processes(workers) if workers > 1 else nullcontext() as pool:
        counted = Counted.room(len(pairs))
        for chunk in pool.executor.map(work, chunks) if pool else map(work, chunks):
            counted.put(chunk)
            advance(len(chunk.frame_ids))
    return counted


def _count_chunk(predicted: LabelledFrames, truth: LabelledFrames, pairs: Sequence[Pair]) -> Counted:
    counted = Counted.room(len(pairs))
    for pair in pairs:
        target = truth.load(pair.truth)
        counted.put(count_frame(predicted.load(pair.predicted), target, camera_of(truth, target)))
    return counted


def count_frame(predicted: FrameLabels, truth: FrameLabels, camera: Intrinsics) -> Counted:
    """Count one frame. camera: undistorted, of the whole image (``camera_of``).

    Raises CloudError where the two are no labels of the same depth image, FormatError for malformed notes.
    """
    _check_same(predicted, truth)
    traits = traits_of(truth, predicted, pinhole_of(truth, camera))
    counts = count(truth, predicted, traits.mm_per_px).flat
    if counts.max(initial=0) > np.iinfo(np.int32).max:
        raise CloudError(f"frame {truth.frame_id} is too large to be counted; compare smaller images")
    return Counted(
        [truth.frame_id],
        # One text for all frames of a person.
        [intern(truth.subject)],
        [traits],
        [Digests(_digest(truth.depth_mm), _digest(truth.parts), _digest(predicted.parts))],
        counts[None].astype(np.int32),
        observe(predicted, truth, camera)[None],
    )


def _digest(image: NDArray[np.generic]) -> str:
    return hashlib.blake2b(image.tobytes(), digest_size=8).hexdigest()


def _check_same(predicted: FrameLabels, truth: FrameLabels) -> None:
    if predicted.parts.shape != truth.parts.shape:
        raise CloudError(
            f"frame {truth.frame_id} is {predicted.parts.shape} in the prediction but {truth.parts.shape} "
            "in the truth; compare labels over the same depth images"
        )
    differ = int(np.count_nonzero(predicted.depth_mm != truth.depth_mm))
    if differ:
        raise CloudError(
            f"frame {truth.frame_id} has another depth image in the prediction than in the truth "
            f"({differ} of {truth.depth_mm.size} pixels differ); compare labels of the same recording"
        )
