"""Validation of the suit network on held-out frames, before border refinement."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from annotate.array_types import Int64
from annotate.scheme.scheme import UNDEFINED
from annotate.segmentation.input_channels import network_input
from annotate.segmentation.suit_network import other_person
from eval.training.calibration.confidence_temperature import temperature_of
from eval.training.segmentation.augmentation import flip, sample_as_labelled
from eval.training.segmentation.examples import Example, ExampleFiles
from eval.training.segmentation.network import SuitNet

MEASURED, SCATTERED = 200, 500  # frames at most, and samples of each for the temperature; untuned


class Validation(NamedTuple):
    """Mean recall over parts, the person's IoU, and the best temperature for calibrating probabilities."""

    recall: float
    person_iou: float
    temperature: float


def validate(network: SuitNet, examples: ExampleFiles, sample_m: float) -> Validation:
    """Validate a network on examples, segmented as in labelling but without border refinement."""
    network.eval()
    classes = other_person(network.scheme) + 1
    table, scores, targets = np.zeros((classes, classes), np.int64), [], []
    for index in examples.spread(MEASURED):
        views, target = _scores(network, examples[index], sample_m)
        found = torch.softmax(views, 2).mean(0).argmax(1).numpy()
        table += np.bincount(target * classes + found, minlength=classes**2).reshape(classes, -1)
        some = torch.linspace(0, max(len(target) - 1, 0), min(SCATTERED, len(target))).long()
        scores.append(views[:, some])
        targets.append(torch.from_numpy(target)[some])
    parts = slice(1, classes - 1)
    there = table[parts].sum(axis=1)
    recall = (table.diagonal()[parts] / np.maximum(there, 1))[there > 0]
    both, either = table[parts, parts].sum(), table[parts].sum() + table[:, parts].sum()
    return Validation(
        float(recall.mean()) if len(recall) else 0.0,
        float(both / max(either - both, 1)),
        temperature_of(torch.cat(scores, dim=1), torch.cat(targets)),
    )


def _scores(network: SuitNet, example: Example, sample_m: float) -> tuple[Tensor, Int64]:
    """Return scores (2, n, K + 1), of a frame and its flip, and targets (n,) of its known samples."""
    sample, scheme = sample_as_labelled(example, sample_m), network.scheme
    views = [network_input(view.planes, len(scheme.parts)) for view in (sample, flip(sample, scheme))]
    with torch.no_grad():
        own, other = network(torch.from_numpy(np.stack(views)))
    scores = torch.stack([own, other[[*scheme.twin_classes.tolist(), other_person(scheme)]].flip(-1)])
    known = sample.target != UNDEFINED
    return scores[:, :, torch.from_numpy(known)].transpose(1, 2), sample.target[known].astype(np.int64)
