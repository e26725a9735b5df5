"""Frames of a prediction beside those of the truth, counted one after the other or on all cores."""

import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from sys import intern

import numpy as np
from numpy.typing import NDArray

from annotate.frame_labels import FrameLabels
from annotate.labelset.dataset import frame_ids_of, read_shard
from annotate.labelset.store import LabelSet
from eval.scores.big_arrays import room
from eval.scores.counts import WIDTH, count
from eval.scores.frames import Frames, camera_of, open_frames, pinhole_of
from eval.scores.joint_errors import OBSERVED, Observed, observe
from eval.scores.traits import Traits, traits_of
from sensors.errors import CloudError, FormatError
from sensors.rig.camera import Intrinsics
from synth.images.workers import processes

CHUNK = 64
"""Frames of a label set that a worker counts in one go; of a dataset it is a shard."""
WORTH_WORKERS = 400
"""Fewer frames are counted sooner than worker processes have started."""


@dataclass(frozen=True, slots=True)
class Pair:
    """A frame's id, and the shards that hold its prediction and its truth: "" in a label set."""

    frame_id: str
    predicted_shard: str
    truth_shard: str


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
    counts: NDArray[np.int32]
    joints: Observed

    @staticmethod
    def room(frames: int) -> "Counted":
        """Of no frame yet, with room for the arrays of so many. Raises CloudError where there is none."""
        return Counted([], [], [], [], room((frames, WIDTH), np.int32), room((frames,), OBSERVED))

    def put(self, some: "Counted") -> None:
        """Add frames behind those that are there."""
        rows = slice(len(self.frame_ids), len(self.frame_ids) + len(some.frame_ids))
        self.counts[rows], self.joints[rows] = some.counts, some.joints
        for name in ("frame_ids", "subjects", "traits", "digests"):
            getattr(self, name).extend(getattr(some, name))


class Reader:
    """Frames of a label set or a dataset by id; of a dataset fast only in the order of its shards."""

    def __init__(self, frames: Frames) -> None:
        self._frames = frames
        self._shard = ""
        self._rest: Iterator[FrameLabels] = iter(())

    def read(self, frame_id: str, shard: str) -> FrameLabels:
        """The frame that lies in this shard. Raises FormatError where it cannot be read."""
        if isinstance(self._frames, LabelSet):
            return self._frames.read(frame_id)
        found = self._next(frame_id) if shard == self._shard else None
        if found is None:
            self._shard, self._rest = shard, read_shard(self._frames.path / shard)
            found = self._next(frame_id)
        assert found is not None, "the shard was listed as holding the frame"
        return found

    def _next(self, frame_id: str) -> FrameLabels | None:
        return next((frame for frame in self._rest if frame.frame_id == frame_id), None)


def pair_up(predicted: Frames, truth: Frames) -> tuple[list[Pair], int]:
    """Each frame of the truth with the prediction of the same id, and how many predictions are left over.

    Raises CloudError where the truth has no frame, or the prediction lacks one: leaving out what failed
    would flatter the score. Raises FormatError where a dataset has a frame twice or cannot be read.
    """
    known, wanted = _shards_of(predicted), _shards_of(truth)
    if not wanted:
        raise CloudError(f"{truth.path} holds no frames; give a label set or dataset with frames")
    missing = [frame_id for frame_id in wanted if frame_id not in known]
    if missing:
        raise CloudError(
            f"{predicted.path} lacks {len(missing)} of the {len(wanted)} frames of {truth.path}, "
            f"first {missing[0]}; predict or label them, or take them out of the truth"
        )
    return [Pair(i, known[i], shard) for i, shard in wanted.items()], len(known) - len(wanted)


def _shards_of(frames: Frames) -> dict[str, str]:
    if isinstance(frames, LabelSet):
        return dict.fromkeys(frames.frame_ids, "")
    shards: dict[str, str] = {}
    for name, _ in frames.shards:
        for frame_id in frame_ids_of(frames.path / name):
            if frame_id in shards:
                raise FormatError(f"{frames.path} holds frame {frame_id!r} twice; generate it again")
            shards[frame_id] = name
    return shards


def count_pairs(
    predicted: Frames,
    truth: Frames,
    pairs: Sequence[Pair],
    advance: Callable[[int], None],
    workers: int | None = None,
) -> Counted:
    """Count every pair, in order. advance: told how many more are done. workers: processes to use.

    Raises CloudError naming a frame whose two sides do not belong together, FormatError for a corrupt one.
    """
    if workers is None:
        workers = len(os.sched_getaffinity(0)) if len(pairs) >= WORTH_WORKERS else 1
    work, chunks = partial(_count_chunk, predicted.path, truth.path), _chunks(pairs)
    with processes(workers) if workers > 1 else nullcontext() as pool:
        counted = Counted.room(len(pairs))
        for chunk in pool.executor.map(work, chunks) if pool else map(work, chunks):
            counted.put(chunk)
            advance(len(chunk.frame_ids))
    return counted


def _chunks(pairs: Sequence[Pair]) -> list[list[Pair]]:
    chunks = []
    for shard, group in groupby(pairs, key=lambda pair: pair.truth_shard):
        own = list(group)
        size = len(own) if shard else CHUNK
        chunks += [own[i : i + size] for i in range(0, len(own), size)]
    return chunks


def _count_chunk(predicted_path: Path, truth_path: Path, pairs: list[Pair]) -> Counted:
    predicted, truth = open_frames(predicted_path), open_frames(truth_path)
    guesses, targets = Reader(predicted), Reader(truth)
    counted = Counted.room(len(pairs))
    for pair in pairs:
        guess = guesses.read(pair.frame_id, pair.predicted_shard)
        target = targets.read(pair.frame_id, pair.truth_shard)
        counted.put(count_frame(guess, target, camera_of(truth, target)))
    return counted


def count_frame(predicted: FrameLabels, truth: FrameLabels, camera: Intrinsics) -> Counted:
    """Count one frame. camera: undistorted, of the whole image (``eval.scores.frames.camera_of``).

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
