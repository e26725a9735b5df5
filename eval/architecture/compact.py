"""Compact U-Net with attention over the whole person and heads for facing, posture and joints.

Constants are untuned unless a source is given.
"""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from annotate.parts import PAPER
from annotate.posture import POSTURES
from annotate.scheme.scheme import Scheme
from eval.architecture.blocks import NetworkOutput, convolution, self_attention
from eval.architecture.class_scores import class_scores, softmax
from eval.architecture.joint_head import JointHead
from eval.architecture.kinds import Kinds
from eval.scores.joints import N_JOINTS

JOINT_LEVELS = (2, 1)
"""Halvings after the first of the coarse and fine maps of joints: 27 and 53 cells a side of a crop of 212."""
HEAD_WIDTH = 32  # channels of an attention head
TURNING = 64  # width of the layer between joints and facing


@dataclass(frozen=True)
class CompactConfig:
    """Numbers of channels after the stem and after each halving; number of attention layers at the coarsest
    level.
    """

    widths: tuple[int, ...] = (16, 32, 64, 128, 192)
    layers: int = 4


class CompactUNet(nn.Module):
    """Network for a depth crop in [0, 1]: class scores at the same resolution, facing, posture and joints.

    The stem halves the resolution and a pixel shuffle restores it. At the coarsest level every cell attends
    to every other. Each pixel first gets a class without side, e.g. arm. One more score per pixel gives left
    or right, with weights computed from the whole person; a scheme without sides has no such weights.
    """

    def __init__(self, config: CompactConfig = CompactConfig(), scheme: Scheme = PAPER) -> None:
        super().__init__()
        self.classes = Kinds.of(scheme)
        w, whole, fine = config.widths, config.widths[-1], config.widths[0] + 8
        self.stem = convolution(1, w[0], stride=2)
        self.down = nn.ModuleList(
            nn.Sequential(convolution(a, b, stride=2), convolution(b, b)) for a, b in pairwise(w)
        )
        self.place = nn.Conv2d(whole, whole, 3, padding=1, groups=whole)
        self.attention = nn.ModuleList(_Attention(whole) for _ in range(config.layers))
        self.up = nn.ModuleList(
            convolution(below + skip, skip) for skip, below in zip(w[-2::-1], w[:0:-1], strict=True)
        )
        self.refine = convolution(w[0] + 4, fine)
        self.kinds = nn.Conv2d(fine, 4 * len(self.classes), 1)
        self.sides = nn.Linear(whole, 4 * (fine + 1)) if any(self.classes.sides) else None
        self.facing = nn.Linear(whole, 2)
        self.turned = nn.Sequential(
            nn.Linear(3 * N_JOINTS, TURNING), nn.ReLU(inplace=True), nn.Linear(TURNING, 2)
        )
        self.posture = nn.Linear(whole, len(POSTURES))
        coarse, fine_cells = (w[min(level, len(w) - 1)] for level in JOINT_LEVELS)
        self.joint_head = JointHead(coarse, fine_cells, whole, len(self.classes.of_class))

    def forward(self, depth: Tensor) -> NetworkOutput:
        """Return the output for depth (B, 1, H, W) float32; H and W are even."""
        cells, others = self.factors(depth)
        return NetworkOutput(class_scores(self.classes, *in_pixels(cells)), *others)

    def factors(
        self, depth: Tensor, temperature: float = 1.0
    ) -> tuple[tuple[Tensor, Tensor | None], tuple[Tensor, ...]]:
        """Return scores of cells, divided by a temperature, then the outputs after the scores.

        Channels are the 2 x 2 pixels of a cell, row by row, of each kind (B, 4 n, H / 2, W / 2). Scores of
        the side follow (B, 4, H / 2, W / 2), None without sides. See ``in_pixels``.
        """
        x = self.stem(depth)
        skips = [x]
        for stage in self.down:
            x = stage(x)
            skips.append(x)
        x, whole = self._attend(skips.pop())
        levels = [x]
        for stage in self.up:
            skip = skips.pop()
            x = nn.functional.interpolate(x, size=skip.shape[-2:], mode="nearest")
            x = stage(torch.cat([x, skip], dim=1))
            levels.append(x)
        # The raw pixels again, because the last stage needs edges at full resolution.
        x = self.refine(torch.cat([x, nn.functional.pixel_unshuffle(depth, 2)], dim=1))
        coarse, fine = (levels[max(0, len(levels) - 1 - level)] for level in JOINT_LEVELS)
        side = self._side(x, whole)
        labels = self._labels(x, None if side is None else _shuffled(side), fine.shape[-2:]).detach()
        joints, deviations, states, maps = self.joint_head((coarse, fine), labels, depth, whole)
        facing = self.facing(whole) + self.turned((joints - joints.mean(dim=1, keepdim=True)).flatten(1))
        # ONNX Runtime folds the factor into the convolution.
        kinds = self.kinds(x) * (1 / temperature)
        side = None if side is None else side * (1 / temperature)
        return (kinds, side), (facing, self.posture(whole), joints, deviations, states, maps)

    def _attend(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return cells (B, C, h, w) after attention, and their mean (B, C)."""
        x = x + self.place(x)
        cells = x.flatten(2).transpose(1, 2)
        for layer in self.attention:
            cells = layer(cells)
        return cells.transpose(1, 2).reshape(x.shape), cells.mean(dim=1)

    def _side(self, x: Tensor, whole: Tensor) -> Tensor | None:
        """Return the scores (B, 4, H / 2, W / 2) of left against right in each cell; None without sides.

        whole: (B, C), mean of the attention cells.
        """
        if self.sides is None:
            return None
        batch, channels, height, width = x.shape
        weights = self.sides(whole).reshape(batch, 4, channels + 1)
        side: Tensor = weights[..., :-1] @ x.flatten(2) + weights[..., -1:]
        return side.reshape(batch, 4, height, width)

    def _labels(self, x: Tensor, side: Tensor | None, size: torch.Size) -> Tensor:
        """Return label probabilities (B, K, h, w) of larger cells: the softmax of a cell's mean scores.

        side: (B, 1, H, W), None without sides. One convolution scores and averages the cells of ``x``.
        """
        step = 1 if x.shape[-2:] == size else 2
        count = len(self.classes)
        bias = self.kinds.get_parameter("bias").reshape(count, 4).mean(dim=1)
        weight = self.kinds.weight.reshape(count, 4, -1, 1, 1).mean(dim=1) / step**2
        odd = [-n % step for n in x.shape[:1:-1]]
        if any(odd):
            x = nn.functional.pad(x, (0, odd[0], 0, odd[1]), mode="replicate")
        kinds = nn.functional.conv2d(x, weight.expand(-1, -1, step, step), bias, step)
        of_class = softmax(kinds)[:, list(self.classes.of_class)]
        if side is None:
            return of_class
        left = torch.sigmoid(nn.functional.avg_pool2d(side, 2 * step, ceil_mode=True))
        shares = torch.cat([torch.ones_like(left), left, 1 - left], dim=1)
        return of_class * shares[:, [which % 3 for which in self.classes.sides]]


def in_pixels(cells: tuple[Tensor, Tensor | None]) -> tuple[Tensor, Tensor | None]:
    """Return scores of kinds (B, n, H, W) and of the side (B, 1, H, W) from scores of cells."""
    kinds, side = cells
    return _shuffled(kinds), None if side is None else _shuffled(side)


def _shuffled(cells: Tensor) -> Tensor:
    return nn.functional.pixel_shuffle(cells, 2)


class _Attention(nn.Module):
    """Transformer layer with normalisation before each block (pre-norm)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.heads = max(1, width // HEAD_WIDTH)
        self.before, self.after = nn.LayerNorm(width), nn.LayerNorm(width)
        self.query_key_value = nn.Linear(width, 3 * width)
        self.mixed = nn.Linear(width, width)
        self.thought = nn.Sequential(nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width))

    def forward(self, cells: Tensor) -> Tensor:
        shape = cells.shape
        projected = self.query_key_value(self.before(cells))
        cells = cells + self.mixed(self_attention(projected, shape, self.heads))
        thought: Tensor = self.thought(self.after(cells))
        return cells + thought
