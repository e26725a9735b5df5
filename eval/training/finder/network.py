"""The person finder's network and its training on stored scenes. Constants are untuned."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.data import DataLoader, Dataset

from annotate.person.detection.finder_network import MULTIPLE
from eval.architecture.blocks import convolution
from eval.network.onnx_export import export_any_size, halve_onnx
from eval.training.finder.images import SceneImages, draw_batch
from eval.training.loader import no_opencv_threads, workers_watched
from eval.training.resumable_loop import Schedule, State, fit, resumed
from synth.images.workers import check_semaphores
from synth.random_stream import stream

INPUTS, FINE = 24, 16  # channels of the input, and of the layers at half of the image's sides
WIDTHS = (16, 32, 48, 80, 112)  # channels at a quarter, an eighth and so on of the image's sides
BATCH, RATE, AVERAGED = 16, 2e-3, 0.998
AHEAD = 4  # batches that a worker draws in advance
OVERLAP_WEIGHT, VOTE_WEIGHT = 0.5, 0.4  # of the losses by overlap and by votes


class FinderNet(nn.Module):
    """Network for inputs (B, 24, h, w), sides multiples of 32 -> (B, 7, h, w).

    The output has four log odds, for the 2 x 2 image pixels of each input cell (see `network_input`), and the
    votes of `Batch`. Layers at a quarter of the image's sides and below find persons; layers at half
    resolution refine the silhouette.
    """

    def __init__(self) -> None:
        super().__init__()
        first, *deeper = WIDTHS
        self.fine = convolution(INPUTS, FINE)
        self.stem = nn.Sequential(convolution(INPUTS, first, 5, 2, 2), convolution(first, first))
        steps = zip(WIDTHS, deeper, strict=False)
        self.down = nn.ModuleList(
            nn.Sequential(convolution(a, b, stride=2), convolution(b, b)) for a, b in steps
        )
        self.more = nn.ModuleList(map(Residual, deeper[:-1]))
        self.deep = nn.Sequential(convolution(WIDTHS[-1], WIDTHS[-1]), convolution(WIDTHS[-1], WIDTHS[-1]))
        back = list(zip(WIDTHS[::-1], WIDTHS[-2::-1], strict=False))
        self.across = nn.ModuleList(nn.Conv2d(a, b, 1) for a, b in back)
        self.up = nn.ModuleList(convolution(b, b) for _, b in back)
        self.head = nn.Conv2d(first, 16, 1)
        self.to_rim = nn.Conv2d(first, FINE, 1)
        self.rim = nn.Sequential(convolution(FINE, FINE), nn.Conv2d(FINE, 4, 1))

    def forward(self, image: Tensor) -> Tensor:
        """Return log odds and votes of images (B, C, h, w)."""
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


class Residual(nn.Module):
    """Two layers whose output is added to their input."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = convolution(channels, channels)
        self.second = nn.Sequential(*list(convolution(channels, channels))[:-1])
        nn.init.zeros_(self.second.get_parameter("1.weight"))

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.second(self.first(x)))


def _twice(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2.0, mode="nearest")


class TensorBatch(NamedTuple):
    """`Batch` as tensors."""

    inputs: Tensor
    person: Tensor
    votes: Tensor
    weight: Tensor


@dataclass(frozen=True)
class _Batches(Dataset[TensorBatch]):
    """Batches of training steps by their numbers."""

    images: SceneImages

    def __getitem__(self, step: int) -> TensorBatch:
        return TensorBatch(*map(torch.from_numpy, draw_batch(self.images, BATCH, stream(0, "finder", step))))


@dataclass(frozen=True)
class FinderTraining:
    """Training of the finder; an ``eval.training.resumable_loop.Training``.

    minutes: length by the clock, instead of ``steps``. workers: processes that draw batches in advance, 0 =
    none.
    """

    images: SceneImages
    steps: int
    peak_rate: float = RATE
    minutes: float | None = None
    workers: int = 0

    @property
    def schedule(self) -> Schedule:
        return Schedule(
            self.peak_rate, AVERAGED, epoch_steps=self.steps, minutes=self.minutes, weight_decay=1e-3
        )

    def batches(self, step: int) -> Iterator[TensorBatch]:
        """Yield batches; a step's batch depends on its number alone."""
        if self.workers:
            check_semaphores()
        steps: Any = count(step)  # torch takes any iterable
        loader = DataLoader(
            _Batches(self.images),
            batch_size=None,
            sampler=steps,
            num_workers=self.workers,
            pin_memory=torch.cuda.is_available(),
            prefetch_factor=AHEAD if self.workers else None,
        )
        with no_opencv_threads():
            drawn = iter(loader)
        yield from drawn

    def loss(self, network: nn.Module, batch: TensorBatch, share: float) -> tuple[Tensor, float]:
        """Return the loss of the log odds, by pixels and by overlap, plus the loss of the votes."""
        device = next(network.parameters()).device
        inputs, person, votes, weight = (tensor.to(device, non_blocking=True) for tensor in batch)
        with torch.autocast(device.type, torch.bfloat16):
            found = network(inputs.contiguous(memory_format=torch.channels_last)).float()
        odds = functional.pixel_shuffle(found[:, :4], 2)[:, 0]
        known = (weight > 0).float()
        own = person * known
        by_pixel = functional.binary_cross_entropy_with_logits(odds, person, reduction="none")
        by_pixel = (by_pixel * weight).sum() / known.sum().clamp(min=1)
        chance = torch.sigmoid(odds) * known
        both, either = (chance * own).sum((1, 2)), chance.sum((1, 2)) + own.sum((1, 2)) + 1
        apart = ((1 - 2 * both / either) * (own.sum((1, 2)) > 0)).mean()
        voting = own[:, None, ::2, ::2]
        astray = ((found[:, 4:] - votes).abs() * voting).sum() / voting.sum().clamp(min=1)
        loss: Tensor = by_pixel + OVERLAP_WEIGHT * apart + VOTE_WEIGHT * astray
        return loss, loss.item()

    def record(self, state: State, loss: float) -> bool:
        """Return False, because ``fit`` saves the state by the clock."""
        return False


def train_finder(
    training: FinderTraining, checkpoint: Path, watch: Callable[[int, float], None], start: Path | None = None
) -> nn.Module:
    """Train a finder on the GPU if any, or resume from its checkpoint; return the moving average.

    start: ONNX file by ``export_finder`` with the first weights; None = random ones.
    """
    torch.manual_seed(0)
    network = (load_finder(start) if start else FinderNet()).to(
        "cuda" if torch.cuda.is_available() else "cpu"
    )
    state = resumed(network, training.schedule, checkpoint)
    with workers_watched():
        return fit(training, state, checkpoint, watch).cpu()


def load_finder(path: Path) -> FinderNet:
    """Return the network in a file by ``export_finder``."""
    import onnx
    from onnx import numpy_helper

    network = FinderNet()
    stored = {
        tensor.name.removesuffix("_half"): torch.from_numpy(numpy_helper.to_array(tensor).astype(np.float32))
        for tensor in onnx.load(path).graph.initializer
    }
    counters = {name: value for name, value in network.state_dict().items() if "num_batches" in name}
    network.load_state_dict(stored | counters)
    return network


def averaged_finder(new: Path, old: Path, share: float) -> FinderNet:
    """Return the network whose weights are ``share`` times those in the file ``new`` plus the rest of
    those in ``old``; both by ``export_finder``. The new training must have begun with the old weights.
    """
    network, other = load_finder(new), load_finder(old).state_dict()
    for name, tensor in network.state_dict().items():
        if tensor.is_floating_point():
            tensor.lerp_(other[name], 1 - share)
    return network


def export_finder(network: nn.Module, path: Path) -> None:
    """Write a network for `annotate.person.detection.finder_network`, its weights in half precision."""
    export_any_size(network, path, INPUTS, MULTIPLE, ["image", "found"])
    halve_onnx(path)
