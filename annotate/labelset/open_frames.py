"""Labelled frames by their folder: a label set or a dataset."""

from pathlib import Path

from annotate.labelset import dataset, store
from annotate.labelset.frames import LabelledFrames


def holds_frames(path: Path) -> bool:
    """Whether a folder is a label set or a dataset."""
    return any((path / manifest).is_file() for manifest in (store.MANIFEST, dataset.MANIFEST))


def open_frames(path: Path) -> LabelledFrames:
    """Open a label set or a dataset. Raises FormatError when the folder is neither."""
    if (path / dataset.MANIFEST).is_file():
        return dataset.Dataset.open(path)
    return store.LabelSet.open(path)
