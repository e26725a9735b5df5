"""A torch network on crops while it is in training: what it names, and how well."""

from collections.abc import Iterator

import numpy as np
import torch
from torch import nn

from annotate.array_types import Int64, UInt8
from annotate.parts import BACKGROUND, N_CLASSES
from eval.scores.confusion import confusion_matrix
from eval.training.crops import Crops


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
