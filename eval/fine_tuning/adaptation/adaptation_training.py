"""Training of an adaptation: half of a batch is labelled people, half synthetic people of the rehearsal.

On synthetic people the network also keeps to the outputs of the network that it started from.
"""

import hashlib
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor, nn

from annotate.array_types import Int64
from eval.architecture.blocks import NetworkOutput
from eval.architecture.networks import scheme_of
from eval.fine_tuning.adaptation.adaptation_split import AdaptationSplit
from eval.fine_tuning.adaptation.distillation import distance
from eval.training.loader import Batch, BatchOrder, Images, batches
from eval.training.plan import ENDLESS, Loss, ModernRecipe, Plan
from eval.training.resumable_loop import Progress, Schedule, State, fit, load_progress, resumed
from eval.training.train import WEIGHING_IMAGES

Pair = tuple[Batch, Batch]
"""Labelled people and synthetic people of a step."""
TRUTH, KEPT = 0.5, 2.0
"""Weights of the rehearsal's true labels and of its distance from the first network, beside 0.5 for labelled
people; untuned"""
CHECKPOINT_S = 30.0


@dataclass(frozen=True, eq=False)
class AdaptationTraining:
    """Training of the network ``start``, by a plan of ``ModernRecipe``; a ``resumable_loop.Training``."""

    split: AdaptationSplit
    start: nn.Module
    plan: Plan

    @cached_property
    def _recipe(self) -> ModernRecipe:
        assert isinstance(self.plan.recipe, ModernRecipe)
        return self.plan.recipe

    def _order(self, index: Int64, epochs: int) -> BatchOrder:
        return BatchOrder(len(index), self.plan.recipe.batch // 2, epochs, self.plan.seed)

    @cached_property
    def schedule(self) -> Schedule:
        taught = self._order(self.split.taught, self.plan.rounds)
        return self.plan.schedule(taught.epoch_steps, CHECKPOINT_S)

    @cached_property
    def _loss(self) -> Loss:
        crops = self.split.crops
        _, parts = next(crops.chosen(self.split.trained).spread(WEIGHING_IMAGES).batches(WEIGHING_IMAGES))
        return Loss.weighed(self._recipe, parts, scheme=crops.scheme, own=scheme_of(self.start, crops.scheme))

    @cached_property
    def _first(self) -> nn.Module:
        return deepcopy(self.start).to(memory_format=torch.channels_last).eval()  # type: ignore[call-overload, no-any-return]

    def batches(self, step: int) -> Iterator[Pair]:
        groups = (self.split.taught, self.plan.rounds), (self.split.rehearsed, ENDLESS)
        return zip(*(self._batches(index, epochs, step) for index, epochs in groups), strict=False)

    def _batches(self, index: Int64, epochs: int, step: int) -> Iterator[Batch]:
        images = Images(self.split.crops.chosen(index), self.plan.augmentation, self.plan.seed)
        return batches(images, self._order(index, epochs), step)

    def loss(self, network: nn.Module, batch: Pair, share: float) -> tuple[Tensor, float]:
        taught, rehearsed = batch
        depth = torch.cat([taught[0], rehearsed[0]]).contiguous(memory_format=torch.channels_last)
        count = len(taught[0])
        with torch.autocast("cpu", torch.bfloat16, enabled=self.plan.precision == "bfloat16"):
            output = network(depth)
            with torch.no_grad():
                known = self._first(depth[count:])
        of_taught, value = self._loss.of(_slice(output, slice(count)), taught)
        again = _slice(output, slice(count, None))
        of_truth, _ = self._loss.of(again, rehearsed)
        apart = distance(again, known, rehearsed[0], self._recipe)
        return 0.5 * of_taught + TRUTH * of_truth + KEPT * apart, value

    def record(self, state: State, loss: float) -> bool:
        state.progress.epoch_loss += loss
        return False

    @property
    def digest(self) -> str:
        """Return the shortened SHA-256 of all inputs of the training."""
        found = hashlib.sha256(f"{self.plan.described()} {TRUTH} {KEPT} {self.split.crops.crc32}".encode())
        for index in (self.split.taught, self.split.rehearsed):
            found.update(index.tobytes())
        for tensor in self.start.state_dict().values():
            found.update(tensor.contiguous().numpy().tobytes())
        return found.hexdigest()[:16]


def _slice(output: NetworkOutput, images: slice) -> NetworkOutput:
    scores, *others = output
    return NetworkOutput(scores[images], *(None if one is None else one[images] for one in others))


def trained(training: AdaptationTraining, folder: Path, advance: Callable[[int], None]) -> nn.Module:
    """Return the trained network; resume the training of the same inputs in a folder.

    advance: called with the seconds, or the steps without a clock, since the last call.
    """
    checkpoint = checkpoint_of(training, folder)
    state = resumed(deepcopy(training.start), training.schedule, checkpoint)
    done = work_done(training.plan, state.progress)

    def watch(step: int, loss: float) -> None:
        nonlocal done
        now = work_done(training.plan, state.progress)
        advance(now - done)
        done = now

    torch.manual_seed(training.plan.seed)
    return fit(training, state, checkpoint, watch)


def checkpoint_of(training: AdaptationTraining, folder: Path) -> Path:
    """Return the file of a training's checkpoints."""
    return folder / f"{training.digest}.safetensors"


def work_done(plan: Plan, progress: Progress) -> int:
    """Return the finished work in seconds, or in steps without a clock."""
    return progress.step if plan.minutes is None else int(progress.seconds)


def work_left(training: AdaptationTraining, folder: Path) -> tuple[int, str]:
    """Return the remaining work of a training in a folder, and its unit."""
    path, plan, schedule = checkpoint_of(training, folder), training.plan, training.schedule
    done = work_done(plan, load_progress(path) if path.is_file() else Progress())
    if plan.minutes is not None:
        return max(0, round(60 * plan.minutes) - done), "seconds"
    return schedule.epoch_steps * schedule.epochs - done, "steps"
