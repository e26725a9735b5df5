"""Temperature scaling that calibrates a network's confidences after the training."""

import math

import numpy as np
import torch
from torch import Tensor, nn

from annotate.scheme.scheme import UNDEFINED
from eval.architecture.class_scores import merged_scores
from eval.architecture.networks import scheme_of
from eval.training.crops import Crops
from eval.training.progress import Advance, unseen

BATCH = 32  # crops computed at once
PIXELS = 200  # of an image that count, evenly spread; untuned
ROUNDS = 40  # halvings of the range 0.1 to 10: finer than float32


def fitted_temperature(model: nn.Module, crops: Crops, advance: Advance = unseen) -> float:
    """Return the temperature for a network whose probabilities are averaged over an image and its flip.

    advance: called with the number of finished crops.
    """
    return temperature_of(*_pixels(model, crops, advance))


def temperature_of(scores: Tensor, target: Tensor) -> float:
    """Return the softmax temperature with the least cross entropy of scores (V, N, K) and classes (N,); 1 if
    N = 0.

    The probabilities of V views are averaged. Found by bisection of the slope. Source: Guo et al. 2017, On
    Calibration of Modern Neural Networks.
    """
    if not len(target):
        return 1.0
    low, high = math.log(0.1), math.log(10.0)
    for _ in range(ROUNDS):
        middle = (low + high) / 2
        log_t = torch.tensor(middle, requires_grad=True)
        log_chances = nn.functional.log_softmax(scores / log_t.exp(), dim=2).logsumexp(dim=0)
        (slope,) = torch.autograd.grad(nn.functional.nll_loss(log_chances, target), log_t)
        low, high = (middle, high) if slope < 0 else (low, middle)
    return math.exp((low + high) / 2)


def _pixels(model: nn.Module, crops: Crops, advance: Advance) -> tuple[Tensor, Tensor]:
    """Return scores (2, N, K), of image and flip, and classes (N,) of some pixels of each crop."""
    model.eval()
    device = next(model.parameters()).device
    scheme, classes = crops.scheme, scheme_of(model, crops.scheme)
    twins = torch.from_numpy(scheme.twin_classes.astype(np.int64))
    scores, targets = [torch.empty(2, 0, len(twins))], [torch.empty(0, dtype=torch.long)]
    for depth, parts in crops.batches(BATCH):
        images = torch.from_numpy(depth[:, None]).to(device)
        with torch.no_grad():
            own, other = (
                merged_scores(model(view).scores.float().cpu(), classes, scheme)
                for view in (images, images.flip(-1))
            )
        views = torch.stack([own, other[:, twins].flip(-1)], dim=1)
        counted = torch.from_numpy((depth > 0) & (parts != UNDEFINED))
        for image, true, known in zip(
            views, torch.from_numpy(scheme.class_table[parts]).long(), counted, strict=True
        ):
            every = known.flatten().nonzero()[:, 0]
            some = every[torch.linspace(0, max(len(every) - 1, 0), min(PIXELS, len(every))).long()]
            scores.append(image.flatten(2)[:, :, some].transpose(1, 2))
            targets.append(true.flatten()[some])
        advance(len(depth))
    return torch.cat(scores, dim=1), torch.cat(targets)
