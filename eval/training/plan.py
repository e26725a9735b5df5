"""Plan of a training: network, recipe, augmentation, seed. With data and threads it determines every bit."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor, nn

from annotate.array_types import UInt8
from annotate.parts import BACKGROUND, N_CLASSES, UNDEFINED
from eval.network.compact import CompactConfig
from eval.network.network_output import Answer
from eval.network.networks import NetworkConfig, described
from eval.training.augment import Augmentation
from eval.training.body_targets import FACING, JOINTS, POSTURE
from eval.training.processes import ALONE, ProcessGroup

COARSE, COARSE_STEP = 0.7, 4
"""Side of the coarse images over the whole ones', to a multiple of so many pixels; chosen by eye."""
ENDLESS = 10_000
"""Rounds that no training by the clock comes to the end of."""
Precision = Literal["float32", "bfloat16"]


@dataclass(frozen=True)
class ModernRecipe:
    """AdamW, one cycle of the learning rate; mean cross entropy over the pixels that have depth.

    What has no depth is background without a network's help. balance: a class weighs its share of the
    pixels to the power of minus this; 0 is unweighted, 1 lets all parts weigh the same. facing, posture,
    joints: weights of what is known of the whole person, beside the parts' 1. clip: largest norm of a
    gradient. averaged: decay of the weights' moving average. coarse: share of the training that sees images
    of ``COARSE`` times the side, which is twice as fast. statistics: whether normalisation learns those of
    the batches, or keeps its own. All chosen by eye.
    """

    batch: int = 32
    peak_rate: float = 3e-3
    weight_decay: float = 0.02
    balance: float = 0.5
    facing: float = 0.3
    posture: float = 0.1
    joints: float = 3.0
    clip: float = 2.0
    averaged: float = 0.999
    coarse: float = 0.5
    statistics: bool = True


@dataclass(frozen=True)
class PaperRecipe:
    """SGD with momentum at a constant rate; cross entropy summed over all pixels, background too.

    Source: Nishi & Miura 2017, section 3.2, after Oliveira et al. 2016: rate 1e-10, momentum 0.99, batches of
    twelve. The sum over 12 x 212 x 212 pixels makes it the 5.4e-5 of a mean loss.
    """

    batch: int = 12
    rate: float = 1e-10
    momentum: float = 0.99
    clip: float = math.inf
    averaged: float = 0.0
    coarse: float = 0.0
    statistics: bool = True


Recipe = ModernRecipe | PaperRecipe


@dataclass(frozen=True)
class Plan:
    """A training but for its data. precision: of the forward pass.

    epochs: rounds over all images. minutes: how long it lasts instead, its rate falling by the clock; such a
    training is not the same twice.
    """

    network: NetworkConfig = field(default_factory=CompactConfig)
    recipe: Recipe = field(default_factory=ModernRecipe)
    augmentation: Augmentation = field(default_factory=Augmentation)
    epochs: int = 12
    minutes: float | None = None
    seed: int = 0
    precision: Precision = "float32"

    @property
    def rounds(self) -> int:
        """Rounds over all images at most."""
        return self.epochs if self.minutes is None else ENDLESS

    def done(self, rounds: float, seconds: float) -> float:
        """Share of the training that is done, 1 at its end, after so many rounds and seconds."""
        return rounds / self.epochs if self.minutes is None else min(1.0, seconds / (60 * self.minutes))

    def described(self) -> dict[str, Any]:
        """As JSON values; equal exactly for equal plans."""
        kind = "paper" if isinstance(self.recipe, PaperRecipe) else "modern"
        return {
            **asdict(self),
            "network": described(self.network),
            "recipe": {"kind": kind, **asdict(self.recipe)},
        }


def best_precision() -> Precision:
    """bfloat16 on a GPU that computes in it; on a processor float32, which is faster on most."""
    return "bfloat16" if torch.cuda.is_available() and torch.cuda.is_bf16_supported() else "float32"


def optimizer_of(recipe: Recipe, parameters: Iterable[nn.Parameter]) -> torch.optim.Optimizer:
    """The recipe's optimizer; its rate is set before each step by `rate`."""
    match recipe:
        case ModernRecipe():
            return torch.optim.AdamW(parameters, recipe.peak_rate, weight_decay=recipe.weight_decay)
        case PaperRecipe():
            return torch.optim.SGD(parameters, recipe.rate, momentum=recipe.momentum)


def rate(recipe: Recipe, share: float) -> float:
    """The learning rate when a share in [0, 1] of the training is done."""
    return recipe.peak_rate * one_cycle(share) if isinstance(recipe, ModernRecipe) else recipe.rate


def one_cycle(share: float) -> float:
    """Learning rate at a share in [0, 1] of the training, as a factor of its peak.

    Source: Smith & Topin 2018: up by a cosine from 1/25, here over the first 3 %, then down to
    almost nothing.
    """
    up = 0.03
    if share < up:
        return 0.04 + 0.96 * (1 - math.cos(math.pi * share / up)) / 2
    return 1e-4 + (1 - 1e-4) * (1 + math.cos(math.pi * (share - up) / (1 - up))) / 2


def seen_by(recipe: Recipe, depth: Tensor, parts: Tensor, share: float) -> tuple[Tensor, Tensor]:
    """Depth (B, 1, h, w) and parts (B, h, w) as a training sees them when a share of it is done."""
    if share >= recipe.coarse:
        return depth, parts
    side = depth.shape[-1]
    small = round(side * COARSE / COARSE_STEP) * COARSE_STEP
    at = ((torch.arange(small) + 0.5) * side / small).long()
    return depth[..., at, :][..., at], parts[:, at][..., at]


def class_weights(recipe: Recipe, parts: UInt8) -> Tensor:
    """Weight of each class (12,) in the loss, of mean 1 over the pixels of the labels (N, h, w).

    Background inside a person's outline is what the extraction took too much: it weighs as the rarest part.
    """
    if isinstance(recipe, PaperRecipe):
        return torch.ones(N_CLASSES)
    count = np.bincount(parts.ravel(), minlength=256)[:N_CLASSES].astype(np.float64)
    count[BACKGROUND] = 0
    share = count / max(1, count.sum())
    weight = np.where(share > 0, np.maximum(share, 0.01) ** -recipe.balance, 1.0)
    weight[BACKGROUND] = weight[share > 0].max(initial=0.0) or 1.0
    return torch.from_numpy(weight / (weight * share).sum() if share.any() else weight).float()


def loss_of(
    recipe: Recipe,
    answer: Answer,
    depth: Tensor,
    parts: Tensor,
    whole: Tensor,
    weight: Tensor,
    group: ProcessGroup = ALONE,
) -> tuple[Tensor, float]:
    """The loss to minimise, and the parts' mean loss of a pixel.

    depth: (B, 1, h, w). parts: (B, h, w). whole: (B, ROW), see ``eval.training.body_targets``. weight: (12,).
    group: whose images together make the batch; the mean of its processes' losses is that of the batch.
    """
    scores, target = answer.scores.float(), parts.long()
    if isinstance(recipe, ModernRecipe):
        target = torch.where(depth[:, 0] > 0, target, UNDEFINED)
    else:
        weight = torch.ones_like(weight)
    counted = group.total((target != UNDEFINED).sum()).clamp(min=1)
    summed = nn.functional.cross_entropy(scores, target, weight, ignore_index=UNDEFINED, reduction="sum")
    mean = float(group.total(summed) / counted)
    if isinstance(recipe, ModernRecipe):
        return group.world * summed / counted + _loss_of_whole(recipe, answer, whole, group), mean
    return group.world * summed, mean


def _loss_of_whole(recipe: ModernRecipe, answer: Answer, whole: Tensor, group: ProcessGroup) -> Tensor:
    """Weighted loss of facing, posture and joints, each where it is known; 0 of a network without them."""
    if answer.facing is None or answer.posture is None or answer.joints is None:
        return torch.zeros(())
    known, whole = torch.isfinite(whole), whole.nan_to_num(0)
    joints = whole[:, JOINTS].reshape(answer.joints.shape)
    seen = known[:, JOINTS].reshape(joints.shape) & (
        (joints[..., :2] - 0.5).abs().amax(dim=-1, keepdim=True) < 0.5
    )
    posture = torch.where(known[:, POSTURE], whole[:, POSTURE].long(), -1)
    named = nn.functional.cross_entropy(answer.posture.float(), posture, ignore_index=-1, reduction="sum")
    return (
        recipe.facing * _mean((answer.facing.float() - whole[:, FACING]).square(), known[:, FACING], group)
        + recipe.joints * _mean((answer.joints.float() - joints).abs(), seen, group)
        + recipe.posture * group.world * named / group.total(known[:, POSTURE].sum()).clamp(min=1)
    )


def _mean(values: Tensor, known: Tensor, group: ProcessGroup) -> Tensor:
    """Mean of the values that are known; 0 where none is. Over a group: the mean of its processes' means."""
    return group.world * (values * known).sum() / group.total(known.sum()).clamp(min=1)
