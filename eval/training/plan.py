"""Plan of a training: network, recipe, augmentation, seed. With data and threads it determines every bit."""

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor, nn

from annotate.array_types import UInt8
from annotate.parts import PAPER
from annotate.scheme.merging import conversion_table
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Scheme
from eval.architecture.blocks import NetworkOutput
from eval.architecture.class_scores import merged_scores
from eval.architecture.compact import CompactConfig
from eval.architecture.networks import NetworkConfig, described
from eval.training.augment import Augmentation
from eval.training.body_targets import FACING, JOINTS, POSTURE
from eval.training.joint_loss import JointTargets, JointWeights, joint_losses
from eval.training.loader import Batch
from eval.training.processes import ALONE, ProcessGroup
from eval.training.resumable_loop import Schedule

COARSE, COARSE_STEP = 0.7, 4  # side of coarse over whole images, and its multiple in px; untuned
CONTINUED_RATE = 1.5e-3  # peak rate of a training from trained weights, which a higher one unlearns; untuned
ENDLESS = 10_000  # epochs that a training by the clock does not reach
Precision = Literal["float32", "bfloat16"]


@dataclass(frozen=True)
class ModernRecipe:
    """Recipe with AdamW, one cycle of the learning rate, and mean cross entropy over pixels with depth;
    untuned.

    balance: exponent; a class weighs (its share of the pixels) ** -balance. facing, posture, joints: weights
    in the loss, beside 1 for the parts. clip: largest norm of a gradient. averaged: decay of the weights'
    moving average. coarse: share of the training, at its start, on images of ``COARSE`` times the side, which
    is twice as fast. statistics: True to update batch-normalisation statistics.
    """

    batch: int = 32
    peak_rate: float = 3e-3
    weight_decay: float = 0.02
    balance: float = 0.5
    facing: float = 0.3
    posture: float = 0.1
    joints: JointWeights = field(default_factory=JointWeights)
    clip: float = 2.0
    averaged: float = 0.999
    coarse: float = 0.5
    statistics: bool = True

    def continued(self) -> "ModernRecipe":
        """Return the recipe of a training from trained weights: a lower rate, whole images only."""
        return replace(self, peak_rate=CONTINUED_RATE, coarse=0.0)


@dataclass(frozen=True)
class PaperRecipe:
    """Recipe of the paper: SGD with momentum at a constant rate; cross entropy summed over all pixels.

    Source: Nishi & Miura 2017, section 3.2, after Oliveira et al. 2016: rate 1e-10, momentum 0.99, batches of
    twelve. For the mean loss of 12 x 212 x 212 pixels the rate is 5.4e-5.
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
    """Settings of a training, except its data.

    precision: number format of the forward pass. epochs: passes over all images. minutes: length by the clock
    instead; the result then depends on the machine's speed.
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
        """Return the largest number of passes over all images."""
        return self.epochs if self.minutes is None else ENDLESS

    def schedule(self, epoch_steps: int, checkpoint_s: float) -> Schedule:
        """Return the schedule for epochs of ``epoch_steps`` steps."""
        recipe = self.recipe
        if isinstance(recipe, PaperRecipe):
            own = Schedule(recipe.rate, recipe.averaged, momentum=recipe.momentum)
        else:
            own = Schedule(recipe.peak_rate, recipe.averaged, weight_decay=recipe.weight_decay)
        return replace(
            own,
            epochs=self.epochs,
            epoch_steps=epoch_steps,
            minutes=self.minutes,
            clip=recipe.clip,
            statistics=recipe.statistics,
            seed=self.seed,
            checkpoint_s=checkpoint_s,
        )

    def described(self) -> dict[str, Any]:
        """Return the plan as JSON values; equal exactly for equal plans."""
        kind = "paper" if isinstance(self.recipe, PaperRecipe) else "modern"
        return {
            **asdict(self),
            "network": described(self.network),
            "recipe": {"kind": kind, **asdict(self.recipe)},
        }


def best_precision() -> Precision:
    """Return bfloat16 on a GPU that computes in it, else float32, which is faster on most processors."""
    return "bfloat16" if torch.cuda.is_available() and torch.cuda.is_bf16_supported() else "float32"


def fastest_precision() -> Precision:
    """Return ``best_precision``, or bfloat16 on a processor that computes in it, which rounds more."""
    able = torch.cpu.get_capabilities()
    return "bfloat16" if able.get("avx512_bf16") or able.get("amx_bf16") else best_precision()


def at_resolution(recipe: Recipe, depth: Tensor, parts: Tensor, share: float) -> tuple[Tensor, Tensor]:
    """Return depth (B, 1, h, w) and parts (B, h, w), subsampled in the first part of the training.

    share: finished share of the training, 0 to 1.
    """
    if share >= recipe.coarse:
        return depth, parts
    side = depth.shape[-1]
    small = round(side * COARSE / COARSE_STEP) * COARSE_STEP
    at = ((torch.arange(small) + 0.5) * side / small).long()
    return depth[..., at, :][..., at], parts[:, at][..., at]


def class_weights(recipe: Recipe, parts: UInt8, scheme: Scheme = PAPER) -> Tensor:
    """Return the weight of each class (K,) in the loss, of mean 1 over the pixels of labels (N, h, w).

    scheme: of the labels. Background inside a person's outline is an error of the mask and weighs as the
    rarest part.
    """
    if isinstance(recipe, PaperRecipe):
        return torch.ones(len(scheme.class_ids))
    count = np.bincount(parts.ravel(), minlength=256)[scheme.class_ids].astype(np.float64)
    count[BACKGROUND] = 0
    share = count / max(1, count.sum())
    weight = np.where(share > 0, np.maximum(share, 0.01) ** -recipe.balance, 1.0)
    weight[BACKGROUND] = weight[share > 0].max(initial=0.0) or 1.0
    return torch.from_numpy(weight / (weight * share).sum() if share.any() else weight).float()


@dataclass(frozen=True)
class Loss:
    """Loss of a recipe.

    weight: (K,), of the classes of ``scheme``, the labels'. group: the processes that share each batch; the
    mean of their losses is the loss of the batch. own: scheme of the network's classes, if finer: sums of its
    probabilities are trained. paper_weight: (12,), of the classes of ``paper``, whose cross entropy by the
    modern recipe is added for labels of regions: sums of regions trained alone are worse paper parts.
    """

    recipe: Recipe
    weight: Tensor
    group: ProcessGroup = ALONE
    scheme: Scheme = PAPER
    paper_weight: Tensor | None = None
    own: Scheme | None = None

    @classmethod
    def weighed(
        cls,
        recipe: Recipe,
        parts: UInt8,
        group: ProcessGroup = ALONE,
        scheme: Scheme = PAPER,
        own: Scheme | None = None,
    ) -> "Loss":
        """Return the loss whose class weights are counted on labels (N, h, w) of ``scheme``."""
        weight, paper = class_weights(recipe, parts, scheme).to(group.device), None
        if scheme.is_of_regions and isinstance(recipe, ModernRecipe):
            as_paper = conversion_table(scheme, PAPER)[parts]
            paper = class_weights(recipe, as_paper, PAPER).to(group.device)
        return cls(recipe, weight, group, scheme, paper, own)

    def of(self, output: NetworkOutput, batch: Batch) -> tuple[Tensor, float]:
        """Return the loss to minimise, and the mean part loss per pixel to report."""
        depth, parts, whole = batch
        scores = merged_scores(output.scores.float(), self.own or self.scheme, self.scheme)
        weight, group = self.weight, self.group
        target = torch.from_numpy(self.scheme.class_table).to(parts.device)[parts.long()].long()
        if isinstance(self.recipe, ModernRecipe):
            target = torch.where(depth[:, 0] > 0, target, UNDEFINED)
        else:
            weight = torch.ones_like(weight)
        counted = group.total((target != UNDEFINED).sum()).clamp(min=1)
        summed = nn.functional.cross_entropy(scores, target, weight, ignore_index=UNDEFINED, reduction="sum")
        mean = float(group.total(summed) / counted)
        if self.paper_weight is not None:
            summed = summed + self._of_paper(scores, target)
        if isinstance(self.recipe, ModernRecipe):
            return group.world * summed / counted + self._of_body(self.recipe, output, whole, depth), mean
        return group.world * summed, mean

    def _of_paper(self, scores: Tensor, target: Tensor) -> Tensor:
        """Return the summed cross entropy of the parts of ``paper`` from scores and classes of regions."""
        merged = merged_scores(scores, self.scheme, PAPER)
        ids = conversion_table(self.scheme, PAPER)[self.scheme.class_ids]
        table = torch.from_numpy(PAPER.class_table[ids]).to(target.device).long()
        known = target != UNDEFINED
        coarse = torch.where(known, table[torch.where(known, target, 0)], UNDEFINED)
        weight = self.paper_weight
        return nn.functional.cross_entropy(merged, coarse, weight, ignore_index=UNDEFINED, reduction="sum")

    def _of_body(self, recipe: ModernRecipe, output: NetworkOutput, whole: Tensor, depth: Tensor) -> Tensor:
        """Return the weighted loss of facing, posture and joints; unknown targets are left out."""
        if output.facing is None or output.posture is None or output.joints is None:
            return torch.zeros(())
        targets = JointTargets.of(whole[:, JOINTS].reshape(output.joints.shape), depth)
        known, whole = torch.isfinite(whole), whole.nan_to_num(0)
        posture = torch.where(known[:, POSTURE], whole[:, POSTURE].long(), -1)
        named = nn.functional.cross_entropy(output.posture.float(), posture, ignore_index=-1, reduction="sum")
        counted = self.group.total(known[:, POSTURE].sum()).clamp(min=1)
        turned = self._mean((output.facing.float() - whole[:, FACING]).square(), known[:, FACING])
        joints = (self._mean(*one) for one in joint_losses(output, targets, recipe.joints))
        posture_loss = recipe.posture * self.group.world * named / counted
        return recipe.facing * turned + posture_loss + sum(joints)

    def _mean(self, values: Tensor, known: Tensor) -> Tensor:
        """Return the mean of the known values, 0 without any."""
        return self.group.world * (values * known).sum() / self.group.total(known.sum()).clamp(min=1)
