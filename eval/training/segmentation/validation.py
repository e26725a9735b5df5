"""What a network for labels makes of frames held out, before borders are drawn."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from annotate.array_types import Int64
from annotate.parts import N_CLASSES, TWIN_PARTS, UNDEFINED
from annotate.segmentation.input_channels import network_input
from annotate.segmentation.suit_network import CLASSES
from eval.training.segmentation.augmentation import as_labelling, mirrored
from eval.training.segmentation.examples import Example, Stock
from eval.training.segmentation.network import ReaderNet
from eval.training.temperature import temperature_of

MEASURED, SCATTERED = 200, 500
"""Frames held out that are measured, at most, and samples of each that the temperature is fitted to.
Chosen by eye."""


class Outcome(NamedTuple):
    """What a network makes of held-out frames' samples: mean recall over parts, the person's IoU, and the
    temperature at which its probabilities explain them best."""

    recall: float
    person_iou: float
    temperature: float


def outcome(network: ReaderNet, stock: Stock, sample_m: float) -> Outcome:
    """What a network makes of examples, read as in labelling, but for borders."""
    network.eval()
    table, scores, targets = np.zeros((CLASSES, CLASSES), np.int64), [], []
    for index in stock.spread(MEASURED):
        views, target = _read(network, stock[index], sample_m)
        found = torch.softmax(views, 2).mean(0).argmax(1).numpy()
        table += np.bincount(target * CLASSES + found, minlength=CLASSES**2).reshape(CLASSES, -1)
        some = torch.linspace(0, max(len(target) - 1, 0), min(SCATTERED, len(target))).long()
        scores.append(views[:, some])
        targets.append(torch.from_numpy(target)[some])
    return Outcome(*_figures(table), temperature_of(torch.cat(scores, dim=1), torch.cat(targets)))


def _read(network: ReaderNet, example: Example, sample_m: float) -> tuple[Tensor, Int64]:
    """Scores (2, n, 13) and targets (n,) of the known samples of a frame, as it is and in a mirror."""
    sample = as_labelling(example, sample_m)
    views = [network_input(view.planes) for view in (sample, mirrored(sample))]
    with torch.no_grad():
        own, other = network(torch.from_numpy(np.stack(views)))
    scores = torch.stack([own, other[[*TWIN_PARTS, N_CLASSES]].flip(-1)])
    known = sample.target != UNDEFINED
    return scores[:, :, torch.from_numpy(known)].transpose(1, 2), sample.target[known].astype(np.int64)


def _figures(table: Int64) -> tuple[float, float]:
    """Mean recall and person IoU by counts (13, 13), rows are the truth."""
    parts = slice(1, N_CLASSES)
    there = table[parts].sum(axis=1)
    recall = (table.diagonal()[parts] / np.maximum(there, 1))[there > 0]
    both, either = table[parts, parts].sum(), table[parts].sum() + table[:, parts].sum()
    return float(recall.mean()) if len(recall) else 0.0, float(both / max(either - both, 1))
