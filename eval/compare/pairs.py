"""Confusion counts of pairs of predicted and true frames, in one process or on all cores."""

import hashlib
import os
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float64, Int32, UInt8
from annotate.frame_labels import FrameLabels
from annotate.labelset.dataset import Entry
from annotate.labelset.labelled_frames import LabelledFrames, camera_of, pinhole_of
from annotate.scheme.merging import CommonScheme
from eval.compare.common_scheme import converted
from eval.scores.counts import count
from eval.scores.joint_errors import joint_errors_mm, joint_visibility
from eval.scores.traits import Traits, traits_of, writable
from sensors.errors import CloudError, FormatError
from synth.images.workers import processes

CHUNK = 64  # frames of a worker's job; untuned
WORTH_WORKERS = 400  # frames from which worker processes save time; untuned


class Pair(NamedTuple):
    """Entries of a frame in the predicted and in the true set."""

    predicted: Entry
    truth: Entry


class Digests(NamedTuple):
    """Hashes (64 bit, hex) of a frame's depth image and label images, to recognise the frame."""

    depth: str
    truth: str
    predicted: str


class Counted(NamedTuple):
    """Comparison of a frame's predicted labels with the true ones.

    counts: int32 (K,), the confusion and error counts of ``FrameCounts.flat``. joints_mm, joints_seen:
    (15,), errors and visibility of the joints, as in ``eval.scores.joint_errors``.
    """

    frame_id: str
    subject: str
    traits: Traits
    digests: Digests
    counts: Int32
    joints_mm: Float64
    joints_seen: UInt8


def pair_up(predicted: LabelledFrames, truth: LabelledFrames) -> tuple[list[Pair], int]:
    """Return each frame of the truth paired with its prediction, and the number of unpaired predictions.

    Raises CloudError for a truth without frames and for a missing prediction, because leaving out failures
    would raise the score. Raises FormatError for a repeated frame or an unreadable dataset.
    """
    known, wanted = _entries(predicted), _entries(truth)
    if not wanted:
        raise CloudError(f"{truth.path} holds no frames; give a label set or dataset with frames")
    missing = [frame_id for frame_id in wanted if frame_id not in known]
    if missing:
        raise CloudError(
            f"{predicted.path} lacks {len(missing)} of the {len(wanted)} frames of {truth.path}, "
            f"first {missing[0]}; predict or label them"
        )
    return [Pair(known[i], entry) for i, entry in wanted.items()], len(known) - len(wanted)


def _entries(frames: LabelledFrames) -> dict[str, Entry]:
    entries: dict[str, Entry] = {}
    for entry in frames.entries():
        if entry.frame_id in entries:
            raise FormatError(f"{frames.path} holds frame {entry.frame_id!r} twice; generate it again")
        entries[entry.frame_id] = entry
    return entries


Sets = tuple[LabelledFrames, LabelledFrames]
"""Predicted and true frames."""


def count_pairs(
    sets: Sets, pairs: Sequence[Pair], common: CommonScheme, workers: int | None = None
) -> Iterator[Counted]:
    """Yield the comparison of every pair, in order; arguments and errors as in ``compare_sets``."""
    if workers is None:
        workers = len(os.sched_getaffinity(0)) if len(pairs) >= WORTH_WORKERS else 1
    chunks = [pairs[i : i + CHUNK] for i in range(0, len(pairs), CHUNK)]
    work = partial(_count_chunk, sets, common)
    with processes(workers) if workers > 1 else nullcontext() as pool:
        yield from chain.from_iterable(pool.executor.map(work, chunks) if pool else map(work, chunks))


def _count_chunk(sets: Sets, common: CommonScheme, pairs: Sequence[Pair]) -> list[Counted]:
    return [count_frame(*load_pair(sets, pair, common, persons=False), sets[1]) for pair in pairs]


def load_pair(
    sets: Sets, pair: Pair, common: CommonScheme, *, persons: bool = True
) -> tuple[FrameLabels, FrameLabels]:
    """Return the predicted and the true frame in the common scheme. persons: as in ``load``."""
    predicted, truth = sets[0].load(pair.predicted, persons), sets[1].load(pair.truth, persons)
    return (
        converted(predicted, common.scheme, common.from_first),
        converted(truth, common.scheme, common.from_second),
    )


def count_frame(predicted: FrameLabels, truth: FrameLabels, frames: LabelledFrames) -> Counted:
    """Return the comparison of one frame in its scheme. frames: the true set, which gives the camera.

    Raises CloudError for labels of different depth images, FormatError for malformed notes.
    """
    _check_same(predicted, truth)
    camera = camera_of(frames, truth)
    traits = traits_of(truth, predicted, pinhole_of(truth, camera))
    counts = count(truth, predicted, traits.mm_per_px).flat
    if counts.max(initial=0) > np.iinfo(np.int32).max:
        raise CloudError(f"frame {truth.frame_id} has over 2^31 pixels of one kind; compare smaller images")
    return Counted(
        truth.frame_id,
        writable(truth.subject),
        traits,
        Digests(_digest(truth.depth_mm), _digest(truth.parts), _digest(predicted.parts)),
        counts.astype(np.int32),
        joint_errors_mm(predicted, truth, camera),
        joint_visibility(truth, camera),
    )


def _digest(image: NDArray[np.generic]) -> str:
    return hashlib.blake2b(np.ascontiguousarray(image).data, digest_size=8).hexdigest()


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
