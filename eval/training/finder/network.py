"""The person finder's network, and its training for a given time on stored scenes."""

import math
import time
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from annotate.person.finder import MULTIPLE
from eval.network.half_precision import halve_onnx
from eval.training.average import Average
from eval.training.finder.images import Batch, Stock, draw_batch
from eval.training.onnx_file import export_any_size
from synth.random_stream import stream

INPUTS, FINE = 24, 16
"""Channels of the input, and of the layers at half of the image's sides. Untuned."""
WIDTHS = (16, 32, 48, 80, 112)
"""Channels at a quarter, an eighth and so on of the image's sides. Untuned."""
BATCH, RATE, WARM_UP, LAST_RATE = 16, 2e-3, 80, 0.002
"""Images a step, highest rate, steps up to it, and the share of it at the end. Untuned."""
PERSON_WEIGHT, OVERLAP_WEIGHT, VOTE_WEIGHT = 0.5, 0.5, 0.4
"""Extra weight of a person's pixels, and weights of the losses by overlap and by votes. Untuned."""
AVERAGED = 0.998
"""Decay of the weights' moving average. Untuned."""
SAVED_S = 60
"""Seconds between two checkpoints. Untuned."""


class FinderNet(nn.Module):
    """Inputs (B, 24, h, w), sides multiples of 32 -> (B, 7, h, w).

    Four log odds, of the pixels of the image at twice the sides as `network_input` lays them out, and the
    votes of `Batch`. Where a person is, is decided on a quarter of the image's sides and below; the rim on
    half of them.
    """

    def __init__(self) -> None:
        super().__init__()
        first, *deeper = WIDTHS
        self.fine = _layer(INPUTS, FINE)
        self.stem = nn.Sequential(_layer(INPUTS, first, 5, 2), _layer(first, first))
        steps = zip(WIDTHS, deeper, strict=False)
        self.down = nn.ModuleList(nn.Sequential(_layer(a, b, 3, 2), _layer(b, b)) for a, b in steps)
        self.more = nn.ModuleList(map(_Residual, deeper[:-1]))
        self.deep = nn.Sequential(_layer(WIDTHS[-1], WIDTHS[-1]), _layer(WIDTHS[-1], WIDTHS[-1]))
        back = list(zip(WIDTHS[::-1], WIDTHS[-2::-1], strict=False))
        self.across = nn.ModuleList(nn.Conv2d(a, b, 1) for a, b in back)
        self.up = nn.ModuleList(_layer(b, b) for _, b in back)
        self.head = nn.Conv2d(first, 16, 1)
        self.to_rim, self.rim = (
            nn.Conv2d(first, FINE, 1),
            nn.Sequential(_layer(FINE, FINE), nn.Conv2d(FINE, 4, 1)),
        )

    def forward(self, image: Tensor) -> Tensor:
        """Log odds and votes of images."""
        fine, x, kept = self.fine(image), self.stem(image), []
        for i, down in enumerate(self.down):
            kept.append(x)
            x = down(x)
            if i < len(self.more):
                x = self.more[i](x)
        x = self.deep(x)
        for across, up in zip(self.across, self.up, strict=True):
            x = up(_twice(across(x)) + kept.pop())
        coarse = functional.pixel_shuffle(self.head(x), 2)
        rim = self.rim(_twice(self.to_rim(x)) + fine)
        return torch.cat([rim + coarse[:, :1], coarse[:, 1:]], dim=1)


class _Residual(nn.Module):
    """Two layers whose answer is added to their input."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = _layer(channels, channels)
        self.second = nn.Sequential(*list(_layer(channels, channels))[:-1])
        nn.init.zeros_(self.second.get_parameter("1.weight"))

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.second(self.first(x)))


def _twice(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2.0, mode="nearest")


def _layer(channels: int, out: int, side: int = 3, stride: int = 1) -> nn.Sequential:
    convolution = nn.Conv2d(channels, out, side, stride, side // 2, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(out), nn.ReLU(inplace=True))


def train_finder(
    stock: Stock, minutes: float, checkpoint: Path, progress: Callable[[int, float], None]
) -> FinderNet:
    """The moving average of a network trained for so many minutes; progress: called with step and loss.

    checkpoint: file that the state is kept in; training goes on from it where it is there.
    """
    torch.manual_seed(0)
    network = FinderNet().to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]
    average = Average(network, AVERAGED)
    optimizer = torch.optim.AdamW(network.parameters(), RATE, weight_decay=1e-3)
    parts = {"network": network, "average": average.model, "optimizer": optimizer}
    step, spent_s = 0, 0.0
    if checkpoint.exists():
        state = torch.load(checkpoint, weights_only=True)
        for name in parts.keys() & state.keys():
            parts[name].load_state_dict(state[name])
        step, spent_s = state["step"], state["spent_s"]
    saved_s = spent_s
    while (done := spent_s / (60 * minutes)) < 1:
        start = time.monotonic()
        share = 0.5 * (1 + math.cos(math.pi * done)) + LAST_RATE
        for group in optimizer.param_groups:
            group["lr"] = RATE * share * min(1, (step + 1) / WARM_UP)
        loss = loss_of(network, draw_batch(stock, BATCH, stream(0, "finder", step)))
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimizer.step()
        step += 1
        average.add(network, step)
        progress(step, loss.item())
        spent_s += time.monotonic() - start
        if spent_s - saved_s > SAVED_S:
            saved_s = spent_s
            _save(checkpoint, {name: part.state_dict() for name, part in parts.items()}, step, spent_s)
    result: FinderNet = average.model.eval()  # type: ignore[assignment]
    return result


def _save(checkpoint: Path, state: dict[str, object], step: int, spent_s: float) -> None:
    """Write the state of a training, whole or not at all."""
    written = checkpoint.with_suffix(".part")
    torch.save({**state, "step": step, "spent_s": spent_s}, written)
    written.replace(checkpoint)


def loss_of(network: nn.Module, batch: Batch) -> Tensor:
    """Loss of a batch: of the odds by pixels and by overlap, and of the votes."""
    inputs, person, votes, known = (torch.from_numpy(array) for array in batch)
    with torch.autocast("cpu", torch.bfloat16):
        found = network(inputs.contiguous(memory_format=torch.channels_last)).float()
    odds = functional.pixel_shuffle(found[:, :4], 2)[:, 0]
    own = person * known
    by_pixel = functional.binary_cross_entropy_with_logits(odds, person, reduction="none")
    by_pixel = (by_pixel * known * (1 + PERSON_WEIGHT * person)).sum() / known.sum().clamp(min=1)
    believed = torch.sigmoid(odds) * known
    both, either = (believed * own).sum((1, 2)), believed.sum((1, 2)) + own.sum((1, 2)) + 1
    apart = ((1 - 2 * both / either) * (own.sum((1, 2)) > 0)).mean()
    voting = own[:, None, ::2, ::2]
    astray = ((found[:, 4:] - votes).abs() * voting).sum() / voting.sum().clamp(min=1)
    loss: Tensor = by_pixel + OVERLAP_WEIGHT * apart + VOTE_WEIGHT * astray
    return loss


def export_finder(network: FinderNet, path: Path) -> None:
    """Write a network as `annotate.person.finder` reads it, its weights in half precision."""
    export_any_size(network, INPUTS, MULTIPLE, path, "image", "found")
    halve_onnx(path)
