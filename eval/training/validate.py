"""A torch network on crops while it is in training: its labels, their scores, and one fixed frame."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn

from annotate.array_types import Int64, UInt8
from annotate.labelset.images import encode_depth, encode_parts
from annotate.parts import BACKGROUND, N_CLASSES
from eval.scores.confusion import confusion_matrix
from eval.training.crops import Crops
from sensors.files.atomic import write_bytes


def predicted(model: nn.Module, crops: Crops, batch: int = 32) -> Iterator[UInt8]:
    """Part ids (B, h, w) of a network on crops, as `predict` names them: a part wherever there is depth."""
    model.eval()
    device = next(model.parameters()).device
    for depth, _ in crops.batches(batch):
        x = torch.from_numpy(depth[:, None]).to(device).contiguous(memory_format=torch.channels_last)
        with torch.no_grad():
            parts = model(x)[:, 1:].argmax(1) + 1
        yield np.where(depth > 0, parts.cpu().numpy(), BACKGROUND).astype(np.uint8)


def evaluate(model: nn.Module, crops: Crops, batch: int = 32) -> Int64:
    """Confusion matrix (12, 12) of a network on crops, rows are the truth."""
    total = np.zeros((N_CLASSES, N_CLASSES), np.int64)
    for (_, parts), labels in zip(crops.batches(batch), predicted(model, crops, batch), strict=True):
        total += confusion_matrix(parts, labels)
    return total


@dataclass(frozen=True)
class FixedFrame:
    """One frame and how its labelling grows: depth.png, truth.parts.png, epoch-000.parts.png and on."""

    folder: Path
    crop: Crops
    epochs: int

    def begin(self, model: nn.Module) -> None:
        """Write the frame itself and what the untrained network makes of it."""
        self.folder.mkdir(exist_ok=True)
        write_bytes(self.folder / "depth.png", encode_depth(self.crop.depth(0)))
        write_bytes(self.folder / "truth.parts.png", encode_parts(self.crop.parts(0)))
        self.label(model, 0)

    def label(self, model: nn.Module, epoch: int) -> None:
        """Write the labelling after an epoch: of each to 10, each tenth to 100 and so on, and the last."""
        if epoch > 10 and epoch < self.epochs and epoch % 10 ** (len(str(epoch)) - 1):
            return
        labels = next(predicted(model, self.crop))
        write_bytes(self.folder / f"epoch-{epoch:03d}.parts.png", encode_parts(labels[0]))
