"""Training of the reader for a stage, resumable at any moment.

By seed, examples and plan alone, on one thread: a step draws from its own number, whenever it is taken.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from annotate.parts import BACKGROUND, N_CLASSES, UNDEFINED
from annotate.segmentation.input_channels import network_input
from annotate.segmentation.suit_network import CLASSES
from eval.network.checkpoint import Progress, load_checkpoint, save_checkpoint
from eval.training.average import Average
from eval.training.plan import Precision, one_cycle
from eval.training.segmentation.augmentation import drawn
from eval.training.segmentation.examples import Example, Stock
from eval.training.segmentation.network import ReaderNet
from sensors.errors import CloudError

BATCH, DECAY, CLIP = 8, 0.02, 2.0
"""Samples a step, weight decay, largest norm of a gradient. Chosen by eye."""
ROOM_WEIGHT = 0.7
"""Weight of a sample of the room in the loss, beside 1 of the others: there are many. Chosen by eye."""
BALANCE, RAREST = 0.75, 0.01
"""A part weighs its share of an image's parts to the power of minus this in the loss: 0 gives borders of a
narrow part, as of a hip that is sat on, to its large neighbours, 1 lets all weigh the same and takes as much
from these. Least share that counts. Chosen by eye (docs/adr/0027)."""
SAVED_S = 60.0
"""Seconds between two checkpoints. Chosen by eye."""


@dataclass(frozen=True)
class Stage:
    """A stretch of a training, its learning rate up and down once (`eval.training.plan.one_cycle`).

    sample_m: metres between two samples. side: samples along a drawn image's side, a multiple of 16.
    averaged: decay of the weights' moving average, whose network goes on with the next stage. statistics:
    whether normalisation learns those of the batches, or keeps its own. by_part, spoilt: as of ``drawn``.
    precision: of the forward pass.
    """

    sample_m: float
    side: int
    steps: int
    peak_rate: float
    averaged: float
    statistics: bool = True
    by_part: bool = False
    spoilt: bool = True
    precision: Precision = "float32"


Watch = Callable[[int, float], None]
"""Called after each step with its number, from 1, and its loss."""


def trained(
    network: ReaderNet,
    stock: Stock | Sequence[Example],
    stage: Stage,
    checkpoint: Path,
    seed: int,
    watch: Watch,
) -> ReaderNet:
    """The moving average of a network trained for a stage, or for what is left of it.

    checkpoint: file that the state is kept in. Raises FormatError where it is damaged.
    """
    network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    average, progress = Average(network, stage.averaged), Progress()
    optimizer = torch.optim.AdamW(network.parameters(), stage.peak_rate, weight_decay=DECAY)
    if checkpoint.exists():
        progress = load_checkpoint(checkpoint, network, average.model, optimizer)
    saved = time.monotonic()
    while progress.step < stage.steps:
        for group in optimizer.param_groups:
            group["lr"] = stage.peak_rate * one_cycle(progress.step / stage.steps)
        network.train(stage.statistics)
        loss = _step(network, optimizer, _batch(stock, stage, seed, progress.step), stage.precision)
        progress.step += 1
        average.add(network, progress.step)
        watch(progress.step, loss)
        if time.monotonic() - saved > SAVED_S or progress.step == stage.steps:
            save_checkpoint(checkpoint, network, average.model, optimizer, progress)
            saved = time.monotonic()
    result: ReaderNet = average.model.eval()  # type: ignore[assignment]
    return result


def _batch(stock: Stock | Sequence[Example], stage: Stage, seed: int, step: int) -> tuple[Tensor, Tensor]:
    """Inputs (B, 38, s, s) and targets (B, s, s) of a step."""
    rng = np.random.default_rng((seed, step))
    how = {"by_part": stage.by_part, "spoilt": stage.spoilt}
    samples = [
        drawn(stock[int(rng.integers(len(stock)))], stage.sample_m, stage.side, rng, **how)
        for _ in range(BATCH)
    ]
    inputs = torch.from_numpy(np.stack([network_input(sample.planes) for sample in samples]))
    targets = torch.from_numpy(np.stack([sample.target for sample in samples])).long()
    return inputs.contiguous(memory_format=torch.channels_last), targets


def _step(
    network: ReaderNet, optimizer: torch.optim.Optimizer, batch: tuple[Tensor, Tensor], precision: Precision
) -> float:
    """One step of the optimizer; its loss, the weighted mean cross entropy of the samples that are known."""
    inputs, targets = batch
    # Left after each step: as long as it lasts, the weights that it once rounded are used.
    with torch.autocast("cpu", torch.bfloat16, enabled=precision == "bfloat16"):
        scores = network(inputs)
    weight = weights_of(targets)
    loss = nn.functional.cross_entropy(scores.float(), targets, ignore_index=UNDEFINED, reduction="none")
    loss = (weight * loss).sum() / weight.sum()
    if not math.isfinite(loss.item()):
        raise CloudError("the loss is no longer finite; train with another --seed")
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(network.parameters(), CLIP)
    optimizer.step()
    return loss.item()


def weights_of(targets: Tensor) -> Tensor:
    """Weights (B, h, w) of samples in the loss by their targets (B, h, w), of mean 1 over the parts of each
    image; ``ROOM_WEIGHT`` in the room, 1 on another person, 0 where nothing is known.
    """
    known = nn.functional.one_hot(targets.clamp(max=CLASSES), CLASSES + 1)
    count = known.sum(dim=(1, 2))[:, 1:N_CLASSES].float()
    share = count / count.sum(dim=1, keepdim=True).clamp(min=1)
    parts = share.clamp(min=RAREST) ** -BALANCE
    table = torch.ones(len(targets), CLASSES + 1)
    table[:, 1:N_CLASSES] = parts / (parts * share).sum(dim=1, keepdim=True).clamp(min=1e-9)
    table[:, BACKGROUND], table[:, CLASSES] = ROOM_WEIGHT, 0
    return table.gather(1, targets.clamp(max=CLASSES).flatten(1)).reshape(targets.shape)
