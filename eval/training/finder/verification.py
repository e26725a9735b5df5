"""Training of the person finder's second stage, the verifier. Constants are untuned."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from annotate.array_types import Float32
from annotate.person.detection.verifier import INPUTS, SIDE
from eval.architecture.blocks import convolution
from eval.network.onnx_export import export_crops, halve_onnx
from eval.training.finder.network import Residual
from eval.training.resumable_loop import Schedule, State, fit, resumed
from synth.random_stream import stream

WIDTHS = (16, 32, 64, 96, 128)  # channels at half of the crop's side, a quarter and so on
BATCH, RATE, AVERAGED = 64, 1.5e-3, 0.998
DROPPED = 0.3  # of the last layer's inputs
SHIFT = 6  # greatest shift of a crop, pixels
NO_MASK = 0.1  # share of crops without the mask of the candidate


class Examples(NamedTuple):
    """Inputs (n, 6, SIDE, SIDE) of candidates; whether each is a person (n,), 0 or 1."""

    crops: NDArray[np.float16]
    is_person: Float32

    def joined(self, more: "Examples") -> "Examples":
        """Return these and further examples."""
        return Examples(
            np.concatenate([self.crops, more.crops]), np.concatenate([self.is_person, more.is_person])
        )


class VerifierNet(nn.Module):
    """Network for crops (B, 6, SIDE, SIDE) -> log odds (B, 1) of being a person."""

    def __init__(self) -> None:
        super().__init__()
        steps = pairwise(WIDTHS)
        self.layers = nn.Sequential(
            convolution(INPUTS, WIDTHS[0], 5, 2, 2),
            *(nn.Sequential(convolution(a, b, stride=2), Residual(b)) for a, b in steps),
        )
        self.head = nn.Sequential(nn.Dropout(DROPPED), nn.Linear(2 * WIDTHS[-1], 1))

    def forward(self, crops: Tensor) -> Tensor:
        """Return the log odds of crops."""
        found = self.layers(crops)
        pooled = torch.cat([found.mean((2, 3)), found.amax((2, 3))], dim=1)
        odds: Tensor = self.head(pooled)
        return odds


@dataclass(frozen=True)
class VerifierTraining:
    """Training of the verifier; an ``eval.training.resumable_loop.Training``.

    steps: of ``BATCH`` examples. peak_rate: greatest learning rate.
    """

    examples: Examples
    steps: int
    peak_rate: float = RATE

    @property
    def schedule(self) -> Schedule:
        return Schedule(self.peak_rate, AVERAGED, epoch_steps=self.steps, weight_decay=1e-2)

    def batches(self, step: int) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield batches, half of them persons; a step's batch depends on its number alone."""
        groups = [np.flatnonzero(self.examples.is_person == kind) for kind in (0, 1)]
        while True:
            rng = stream(0, "verifier", step)
            chosen = np.concatenate([rng.choice(group, BATCH // 2) for group in groups])
            crops = augmented(self.examples.crops[chosen].astype(np.float32), rng)
            yield torch.from_numpy(crops), torch.from_numpy(self.examples.is_person[chosen])
            step += 1

    def loss(self, network: nn.Module, batch: tuple[Tensor, Tensor], share: float) -> tuple[Tensor, float]:
        """Return the mean cross entropy, as a tensor and as a number."""
        crops, is_person = batch
        with torch.autocast(crops.device.type, torch.bfloat16):
            odds = network(crops.contiguous(memory_format=torch.channels_last)).float()[:, 0]
        loss = functional.binary_cross_entropy_with_logits(odds, is_person)
        return loss, loss.item()

    def record(self, state: State, loss: float) -> bool:
        """Return False, because ``fit`` saves the state by the clock."""
        return False


def augmented(crops: Float32, rng: np.random.Generator) -> Float32:
    """Return crops (n, 6, SIDE, SIDE) flipped and shifted at random, some without a mask."""
    moved = np.zeros_like(crops)
    flips, shifts = rng.random(len(crops)) < 0.5, rng.integers(-SHIFT, SHIFT + 1, (len(crops), 2))
    for out, crop, is_flipped, (down, right) in zip(moved, crops, flips, shifts, strict=True):
        rows, columns = (slice(max(0, shift), SIDE + min(0, shift)) for shift in (down, right))
        sources = (slice(max(0, -shift), SIDE + min(0, -shift)) for shift in (down, right))
        out[:, rows, columns] = (crop[..., ::-1] if is_flipped else crop)[(slice(None), *sources)]
    moved[rng.random(len(crops)) < NO_MASK, -1] = 0
    return moved


def train_verifier(
    training: VerifierTraining, checkpoint: Path, watch: Callable[[int, float], None]
) -> nn.Module:
    """Train a verifier, or resume from its checkpoint; return the moving average."""
    torch.manual_seed(0)
    state = resumed(VerifierNet(), training.schedule, checkpoint)
    return fit(training, state, checkpoint, watch)


def export_verifier(network: nn.Module, path: Path) -> None:
    """Write a network as `annotate.person.detection.verifier` loads it, its weights in half precision."""
    export_crops(network, path, torch.zeros(2, INPUTS, SIDE, SIDE), ["crop", "odds"])
    halve_onnx(path)
