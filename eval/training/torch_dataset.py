"""Label sets and datasets as a ``torch.utils.data.Dataset``, normalised as our networks take them."""

from pathlib import Path

import torch
from torch import Tensor
from torch.utils.data import Dataset

from annotate.crop import SIZE
from annotate.labelset.convert import in_scheme
from annotate.labelset.labelled_frames import open_frames
from annotate.scheme.merging import conversion_table
from annotate.scheme.scheme import BACKGROUND_PART, UNDEFINED
from annotate.scheme.scheme_file import load_scheme
from eval.training.crops import to_crop


class TorchDataset(Dataset[tuple[Tensor, Tensor]]):
    """Persons' crops of a label set or dataset: depth float32 (1, 212, 212), labels int64 (212, 212).

    Depth is in [0, 1], 0 = none. Labels are classes: 0 = background, then the parts by id; 255 = ignored,
    also where depth is missing. A frame without a person has depth 0 and labels 255.

    scheme: name or file; None = the set's. names: of the classes. The index is made at opening, so access is
    random. Raises FormatError for a broken set, or where its parts would be split.
    """

    def __init__(self, path: str | Path, scheme: str | Path | None = None) -> None:
        self._frames = open_frames(Path(path))
        self.scheme = self._frames.scheme if scheme is None else load_scheme(scheme)
        self.names = tuple(part.name for part in (BACKGROUND_PART, *self.scheme.parts))
        self._table = conversion_table(self._frames.scheme, self.scheme)
        self._entries = tuple(self._frames.entries())

    def __len__(self) -> int:
        return len(self._entries)

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        frame = in_scheme(self._frames.load(self._entries[index]), self.scheme, self._table)
        if not (frame.on_person & (frame.depth_mm > 0)).any():
            labels = torch.full((SIZE, SIZE), UNDEFINED, dtype=torch.int64)
            return torch.zeros(1, SIZE, SIZE), labels
        depth, parts = to_crop(frame)
        classes = torch.from_numpy(self.scheme.class_table[parts]).long()
        return torch.from_numpy(depth[None]), torch.where(torch.from_numpy(depth > 0), classes, UNDEFINED)
