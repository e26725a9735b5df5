"""One training loop for all networks: resumable at any step, deterministic given a seed."""

import json
import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Protocol, TypeAlias, TypeVar

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from eval.network.weights_file import check_fits, read_tensors, write_tensors
from eval.training.processes import ALONE, ProcessGroup
from sensors.errors import CloudError, FormatError, Setting, fault_of

WARM_STEPS = 10.0  # after these the average reaches further back than half of the steps; untuned
B = TypeVar("B")
Tensors: TypeAlias = tuple[Tensor, ...] | list[Tensor]


@dataclass(frozen=True)
class Point:
    """Mean training loss per pixel since the previous point, and the number of images seen so far."""

    images: int
    loss: float


@dataclass(frozen=True)
class Epoch:
    """Results of an epoch: mean training loss, mean recall and mIoU of parts (None: not measured).

    number: from 1. seconds: of the training so far.
    """

    number: int
    loss: float
    mean_recall: float | None
    miou: float | None
    seconds: float


@dataclass
class Progress:
    """Progress of a training: steps, losses not yet in `points` and `epochs`, seconds."""

    step: int = 0
    since_point: list[float] = field(default_factory=list)
    epoch_loss: float = 0.0
    points: list[Point] = field(default_factory=list)
    epochs: list[Epoch] = field(default_factory=list)
    seconds: float = 0.0


@dataclass(frozen=True)
class Schedule:
    """Length of a training and the settings of its optimizer; defaults are untuned.

    epochs: number of epochs of ``epoch_steps`` steps each. minutes: length by the clock, instead of epochs.
    momentum: use SGD at a constant rate; None = AdamW with one cycle of the learning rate. averaged: decay of
    the moving average of the weights, 0 = none. statistics: True to update batch-normalisation statistics.
    """

    peak_rate: float
    averaged: float
    epochs: int = 1
    epoch_steps: int = 1
    minutes: float | None = None
    weight_decay: float = 0.02
    momentum: float | None = None
    clip: float = 2.0
    statistics: bool = True
    seed: int = 0
    checkpoint_s: float = 60.0

    def share(self, progress: Progress) -> float:
        """Return the finished share of the training, 1 at the end."""
        if self.minutes is None:
            return progress.step / self.epoch_steps / self.epochs
        return min(1.0, progress.seconds / (60 * self.minutes))

    def rate(self, share: float) -> float:
        """Return the learning rate at a share in [0, 1] of the training."""
        return self.peak_rate * one_cycle(share) if self.momentum is None else self.peak_rate

    def optimizer(self, parameters: Iterable[nn.Parameter]) -> torch.optim.Optimizer:
        """Return the optimizer; `fit` sets its rate before each step."""
        if self.momentum is None:
            return torch.optim.AdamW(parameters, self.peak_rate, weight_decay=self.weight_decay)
        return torch.optim.SGD(parameters, self.peak_rate, momentum=self.momentum)


def one_cycle(share: float) -> float:
    """Return the learning rate at a share in [0, 1] of a training, as a factor of its peak.

    Up by a cosine from 1/25 over the first 3 %, then down to almost 0. Source: Smith & Topin 2018. torch's
    OneCycleLR counts steps, so it cannot follow the clock.
    """
    up = 0.03
    if share < up:
        return 0.04 + 0.96 * (1 - math.cos(math.pi * share / up)) / 2
    return 1e-4 + (1 - 1e-4) * (1 + math.cos(math.pi * (share - up) / (1 - up))) / 2


class State:
    """All that changes during a training: model, moving average, optimizer and progress."""

    def __init__(self, model: nn.Module, schedule: Schedule) -> None:
        self.model, self.progress, self._schedule = model, Progress(), schedule
        self.optimizer = schedule.optimizer(model.parameters())
        self._average = (
            AveragedModel(model, multi_avg_fn=self._follow, use_buffers=True) if schedule.averaged else None
        )

    @property
    def average(self) -> nn.Module:
        """Return the network to measure and ship: the moving average, or the model without one."""
        return self._average.module if self._average else self.model

    def _follow(self, averages: Tensors, new: Tensors, step: Tensor | int) -> None:
        """Move averages, of one kind of number, towards new values; all in one call, as a GPU wants it."""
        if not new[0].is_floating_point():
            torch._foreach_copy_(averages, new)
            return
        share = 1 - min(self._schedule.averaged, int(step) / (int(step) + WARM_STEPS))
        torch._foreach_lerp_(averages, new, share)

    def step(self, loss: Tensor, share: float) -> None:
        """Take one step of the optimizer and of the moving average."""
        for group in self.optimizer.param_groups:
            group["lr"] = self._schedule.rate(share)
        self.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.model.parameters(), self._schedule.clip)
        self.optimizer.step()
        self.progress.step += 1
        if self._average:
            self._average.n_averaged.fill_(self.progress.step)
            self._average.update_parameters(self.model)

    def save(self, path: Path) -> None:
        """Write a checkpoint atomically. Raises CloudError on a full disk."""
        tensors = {f"model.{name}": value for name, value in self.model.state_dict().items()}
        if self._average:
            tensors |= {f"average.{name}": value for name, value in self.average.state_dict().items()}
        for index, entry in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{index}.{name}": value for name, value in entry.items()}
        write_tensors(path, tensors, {"progress": json.dumps(asdict(self.progress))})

    def load(self, path: Path) -> None:
        """Restore a checkpoint. Raises FormatError for a file that is not a checkpoint of this network."""
        try:
            tensors, meta = read_tensors(path)
            for prefix, network in (("model.", self.model), ("average.", self.average))[
                : 2 if self._average else 1
            ]:
                own = {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}
                check_fits(path, network, own)
                network.load_state_dict(own)
            state: dict[int, dict[str, Tensor]] = {}
            for name, value in tensors.items():
                if name.startswith("optimizer."):
                    _, index, key = name.split(".", 2)
                    state.setdefault(int(index), {})[key] = value
            self.optimizer.load_state_dict({**self.optimizer.state_dict(), "state": state})
            self.progress = _progress(meta)
        except (ValueError, KeyError, RuntimeError, TypeError, FormatError) as error:
            raise _unusable(path, error) from error


def load_progress(path: Path) -> Progress:
    """Return the progress in a checkpoint. Raises FormatError for a file that is not a checkpoint."""
    try:
        return _progress(read_tensors(path)[1])
    except (ValueError, KeyError, TypeError, FormatError) as error:
        raise _unusable(path, error) from error


def _progress(meta: dict[str, str]) -> Progress:
    fields = json.loads(meta["progress"])
    fields["points"] = [Point(**point) for point in fields["points"]]
    fields["epochs"] = [Epoch(**epoch) for epoch in fields["epochs"]]
    return Progress(**fields)


def _unusable(path: Path, error: Exception) -> FormatError:
    reason = fault_of(error).partition("\n")[0] or "no reason is given"
    return FormatError(f"checkpoint {path} cannot be resumed ({reason}); remove it or choose another folder")


class Training(Protocol[B]):
    """Data, loss and schedule of a training."""

    @property
    def schedule(self) -> Schedule:
        """Return the length of the training and the settings of its optimizer."""
        ...

    def batches(self, step: int) -> Iterator[B]:
        """Yield the batches from a step on; a step's batch depends on its number alone."""
        ...

    def loss(self, network: nn.Module, batch: B, share: float) -> tuple[Tensor, float]:
        """Return the loss to minimise and the loss to report.

        share: finished share of the training, 0 to 1.
        """
        ...

    def record(self, state: State, loss: float) -> bool:
        """Process the loss of a finished step; return whether to save the state now."""
        ...


def fit(
    training: Training[B],
    state: State,
    checkpoint: Path,
    watch: Callable[[int, float], None],
    group: ProcessGroup = ALONE,
) -> nn.Module:
    """Train a state to the end of its schedule; return the moving average.

    checkpoint: file of the state, written regularly and at the end; load it first to resume. watch: called
    after each step with its number and its loss. Raises CloudError where the loss is not finite.
    """
    schedule, progress = training.schedule, state.progress
    network = group.together(state.model)
    began, before = time.monotonic(), progress.seconds
    saved = began
    for batch in training.batches(progress.step) if schedule.share(progress) < 1 else ():
        share = schedule.share(progress)
        # Dropout has the step's own seed, so that a resumed training draws the same.
        torch.manual_seed((schedule.seed * 1_000_003 + progress.step) * group.world + group.rank)
        network.train()
        for layer in () if schedule.statistics else network.modules():
            if isinstance(layer, nn.BatchNorm2d):
                layer.eval()
        loss, value = training.loss(network, batch, share)
        if not math.isfinite(value):
            raise CloudError(
                f"the loss of step {progress.step} is not finite; train in float32 or with another seed",
                Setting.PRECISION,
                Setting.SEED,
            )
        state.step(loss, share)
        now = time.monotonic()
        progress.seconds = group.by_the_first(before + now - began)
        over = schedule.share(progress) >= 1
        if training.record(state, value) or over or now - saved >= schedule.checkpoint_s:
            if group.first:
                state.save(checkpoint)
            saved = now
        watch(progress.step, value)
        if over:
            break
    return state.average.eval()


def resumed(model: nn.Module, schedule: Schedule, checkpoint: Path) -> State:
    """Return the state in a training's checkpoint, or a new one if the file does not exist. Raises
    FormatError as ``State.load``.
    """
    state = State(model.to(memory_format=torch.channels_last), schedule)  # type: ignore[call-overload]
    if checkpoint.exists():
        state.load(checkpoint)
    return state
