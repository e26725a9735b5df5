"""Conversion of label sets and datasets to another scheme of parts."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from annotate.array_types import UInt8
from annotate.frame_labels import FrameLabels
from annotate.labelset import dataset, label_set
from annotate.labelset.atomic_folder import appearing, check_outside
from annotate.labelset.dataset import Dataset, encode_shard, read_shard, sha256
from annotate.labelset.images import Probabilities
from annotate.labelset.json_object import encode_object
from annotate.labelset.label_set import LEARNT, LabelSet, journal_problems
from annotate.labelset.labelled_frames import LabelledFrames
from annotate.labelset.scheme_note import SCHEME, scheme_note
from annotate.scheme.merging import conversion_table
from annotate.scheme.scheme import UNDEFINED, Scheme
from sensors.errors import FormatError
from sensors.files.atomic import write_bytes

BY_PART = ("visible",)
"""Notes of synthetic images with a share of the whole person, then of each part by id."""


def convert(
    frames: LabelledFrames, scheme: Scheme, out: Path, advance: Callable[[int], None], *, overwrite: bool
) -> LabelledFrames:
    """Write a label set or a dataset in another scheme; ``out`` appears only when complete.

    Journal and first labels of corrections are left out, and in another scheme the shares of single parts in
    notes; all other fields stay. advance: called with 1 for each frame. Raises FormatError where a part would
    be split, or where the journal is ahead of the labels; ExistsError where ``out`` exists, unless it is
    replaceable and ``overwrite`` is True.
    """
    check_outside(out, frames.path)
    table = conversion_table(frames.scheme, scheme)
    if isinstance(frames, Dataset):
        return _convert_dataset(frames, scheme, out, advance, overwrite)
    if problems := journal_problems(frames):
        raise FormatError(problems[0])
    with appearing(out, label_set.MANIFEST, frames.path, overwrite=overwrite) as folder:
        made = LabelSet.create(folder, frames.intrinsics, _info(frames.info, scheme))
        for frame_id in frames.frame_ids:
            frame, kept = frames.read(frame_id), frames.probabilities(frame_id)
            made.write(in_scheme(frame, scheme, table), _merged(kept, scheme, table) if kept else None)
            step = frame.notes.get(LEARNT)
            if step and frame.confidence is not None:
                made.write_confidence(frame_id, step, frame.confidence)
            advance(1)
    return LabelSet.open(out)


def in_scheme(frame: FrameLabels, scheme: Scheme, table: UInt8) -> FrameLabels:
    """Return a frame in another scheme, without the shares of single parts in ``BY_PART``, which do not add
    up. table: of ``conversion_table``, from the frame's scheme.
    """
    notes = frame.notes
    if scheme != frame.scheme:
        shares = {key: notes[key][:1] for key in BY_PART if isinstance(notes.get(key), list)}
        notes = notes | shares
    return replace(frame, parts=table[frame.parts], notes=notes, scheme=scheme)


def _info(info: Mapping[str, Any], scheme: Scheme) -> dict[str, Any]:
    """Return manifest entries of the converted frames."""
    kept = {key: value for key, value in info.items() if key != SCHEME}
    return kept | scheme_note(scheme)


def _merged(probabilities: Probabilities, scheme: Scheme, table: UInt8) -> Probabilities:
    """Return probabilities of another scheme's classes: sums over the joined classes."""
    planes = np.zeros((scheme.n_classes, *probabilities.planes.shape[1:]), np.float32)
    for own, plane in zip(table.tolist(), probabilities.planes, strict=False):
        if own != UNDEFINED:
            planes[own] += plane
    return replace(probabilities, planes=planes)


def _convert_dataset(
    frames: Dataset, scheme: Scheme, out: Path, advance: Callable[[int], None], overwrite: bool
) -> Dataset:
    table = conversion_table(frames.scheme, scheme)
    shards = []
    with appearing(out, dataset.MANIFEST, frames.path, overwrite=overwrite) as folder:
        for name, _ in frames.shards:
            converted = []
            for frame in read_shard(frames.path / name, scheme=frames.scheme):
                converted.append(in_scheme(frame, scheme, table))
                advance(1)
            write_bytes(folder / name, encode_shard(converted))
            shards.append({"file": name, "sha256": sha256(folder / name)})
        manifest = {"schema": dataset.SCHEMA, **_info(frames.info, scheme), "shards": shards}
        write_bytes(folder / dataset.MANIFEST, encode_object(manifest))
    return Dataset.open(out)
