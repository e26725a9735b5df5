"""The person finder's network and its training by the clock, on stored scenes."""

import copy
import math
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from annotate.array_types import UInt8, UInt16
from eval.training.finder_images import HEIGHT, WIDTH, Batch, draw_batch

WIDTHS = (16, 32, 48, 80, 112)
"""Channels at a half, a quarter and so on of the image's sides: 0.67 million weights. Chosen by eye."""
BATCH, RATE, WARM_UP, LAST_RATE = 16, 3e-3, 80, 0.002
"""Images a step, highest rate, steps up to it, and the share of it at the end. Chosen by eye."""
PERSON_WEIGHT, OVERLAP_WEIGHT, VOTE_WEIGHT = 2.0, 0.5, 0.5
"""Extra weight of a person's pixels, and weights of the losses by overlap and by votes. Chosen by eye."""
AVERAGED = 0.998
"""Share of the moving average that one step keeps. Chosen by eye."""


class FinderNet(nn.Module):
    """Inputs (B, 3, h, w), sides multiples of 32 -> (B, 4, h, w): log odds, and votes as of `Batch`."""

    def __init__(self) -> None:
        super().__init__()
        first, *deeper = WIDTHS
        self.stem = nn.Sequential(_layer(3, first, 5, 2), _layer(first, first))
        steps = zip(WIDTHS, deeper, strict=False)
        self.down = nn.ModuleList(nn.Sequential(_layer(a, b, 3, 2), _layer(b, b)) for a, b in steps)
        self.deep = nn.Sequential(_layer(WIDTHS[-1], WIDTHS[-1]), _layer(WIDTHS[-1], WIDTHS[-1]))
        back = list(zip(WIDTHS[::-1], WIDTHS[-2::-1], strict=False))
        self.across = nn.ModuleList(nn.Conv2d(a, b, 1) for a, b in back)
        self.up = nn.ModuleList(_layer(b, b) for _, b in back)
        self.head = nn.Conv2d(first, 16, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Scores of images."""
        x, kept = self.stem(x), []
        for down in self.down:
            kept.append(x)
            x = down(x)
        x = self.deep(x)
        for across, up in zip(self.across, self.up, strict=True):
            x = up(functional.interpolate(across(x), scale_factor=2.0, mode="nearest") + kept.pop())
        return functional.pixel_shuffle(self.head(x), 2)


def _layer(channels: int, out: int, side: int = 3, stride: int = 1) -> nn.Sequential:
    convolution = nn.Conv2d(channels, out, side, stride, side // 2, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(out), nn.ReLU(inplace=True))


def train_finder(
    images: list[tuple[UInt16, UInt8]], minutes: float, seed: int, progress: Callable[[int, float], None]
) -> FinderNet:
    """The moving average of a network trained for so many minutes; progress: called with step and loss."""
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    network = FinderNet().train()
    average = copy.deepcopy(network)
    optimizer = torch.optim.AdamW(network.parameters(), RATE, weight_decay=1e-3)
    start, step = time.monotonic(), 0
    while (done := (time.monotonic() - start) / (60 * minutes)) < 1:
        share = 0.5 * (1 + math.cos(math.pi * done)) + LAST_RATE
        for group in optimizer.param_groups:
            group["lr"] = RATE * share * min(1, (step + 1) / WARM_UP)
        loss = loss_of(network, draw_batch(images, BATCH, rng))
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimizer.step()
        step += 1
        _follow(average, network, min(AVERAGED, step / (step + 9)))
        progress(step, loss.item())
    return average.eval()


def loss_of(network: nn.Module, batch: Batch) -> Tensor:
    """Loss of a batch: of the odds by pixels and by overlap, and of the votes."""
    inputs, person, votes, known = (torch.from_numpy(array) for array in batch)
    found = network(inputs)
    own, odds = person * known, found[:, 0]
    by_pixel = functional.binary_cross_entropy_with_logits(odds, person, reduction="none")
    by_pixel = (by_pixel * known * (1 + PERSON_WEIGHT * person)).sum() / known.sum().clamp(min=1)
    believed = torch.sigmoid(odds) * known
    both, either = (believed * own).sum((1, 2)), believed.sum((1, 2)) + own.sum((1, 2)) + 1
    apart = ((1 - 2 * both / either) * (own.sum((1, 2)) > 0)).mean()
    astray = ((found[:, 1:] - votes).abs().sum(1) * own).sum() / own.sum().clamp(min=1)
    loss: Tensor = by_pixel + OVERLAP_WEIGHT * apart + VOTE_WEIGHT * astray
    return loss


@torch.no_grad()
def _follow(average: nn.Module, network: nn.Module, kept: float) -> None:
    """Move an average towards a network."""
    for mean, now in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
        if mean.dtype.is_floating_point:
            mean.mul_(kept).add_(now, alpha=1 - kept)
        else:
            mean.copy_(now)


def export_finder(network: FinderNet, path: Path) -> None:
    """Write a network as `annotate.person.depth_finder` reads it."""
    sides = {2: "h", 3: "w"}
    with warnings.catch_warnings():
        # The other exporter needs onnxscript.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            network.eval(),
            (torch.zeros(1, 3, HEIGHT, WIDTH),),
            str(path),
            opset_version=17,
            dynamo=False,
            input_names=["image"],
            output_names=["found"],
            dynamic_axes={"image": sides, "found": sides},
        )
