"""Temperature that makes a network's confidences probabilities, fitted after the training."""

import math

import torch
from torch import Tensor, nn

from annotate.parts import UNDEFINED
from eval.training.crops import Crops

PIXELS = 200
"""Pixels of an image that count, evenly chosen: neighbours are alike; chosen by eye."""
ROUNDS = 40
"""Halvings of the range in which the temperature lies, 0.1 to 10: more than float32 tells apart."""


def fitted_temperature(model: nn.Module, crops: Crops, batch: int = 32) -> float:
    """The temperature at which a network's scores, divided by it, explain the labels of crops best."""
    return temperature_of(*_pixels(model, crops, batch))


def temperature_of(scores: Tensor, target: Tensor) -> float:
    """The temperature at which scores (N, K), divided by it, explain classes (N,) best; 1 without any.

    Source: Guo et al. 2017, On Calibration of Modern Neural Networks; least mean cross entropy, by bisection
    of its slope.
    """
    if not len(target):
        return 1.0
    low, high = math.log(0.1), math.log(10.0)
    for _ in range(ROUNDS):
        middle = (low + high) / 2
        log_t = torch.tensor(middle, requires_grad=True)
        (slope,) = torch.autograd.grad(nn.functional.cross_entropy(scores / log_t.exp(), target), log_t)
        low, high = (middle, high) if slope < 0 else (low, middle)
    return math.exp((low + high) / 2)


def _pixels(model: nn.Module, crops: Crops, batch: int) -> tuple[Tensor, Tensor]:
    """Scores (N, 12) and parts (N,) of some pixels with depth of each crop."""
    model.eval()
    device = next(model.parameters()).device
    scores, targets = [torch.empty(0, 12)], [torch.empty(0, dtype=torch.long)]
    for depth, parts in crops.batches(batch):
        with torch.no_grad():
            answer = model(torch.from_numpy(depth[:, None]).to(device)).scores.float().cpu()
        counted = torch.from_numpy((depth > 0) & (parts != UNDEFINED))
        for image, true, seen in zip(answer, torch.from_numpy(parts).long(), counted, strict=True):
            every = seen.flatten().nonzero()[:, 0]
            some = every[torch.linspace(0, max(len(every) - 1, 0), min(PIXELS, len(every))).long()]
            scores.append(image.flatten(1)[:, some].T)
            targets.append(true.flatten()[some])
    return torch.cat(scores), torch.cat(targets)
