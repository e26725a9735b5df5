"""Joint head: a heat map and a depth map for each joint, its place at the highest peak, its standard
deviation and its visibility.

Constants are untuned unless a source is given.
"""

import math

import torch
from torch import Tensor, nn

from eval.scores.joint_visibility import VISIBILITIES
from eval.scores.joints import N_JOINTS

PEAK, WINDOW = 2, 8
"""Cells on each side of a cell: of which the sum of heat makes a peak, and which the mean position includes.
Chosen by the mean error after 240 steps of training: 95 mm; 102 with 0 and 3, 96 with all cells, which puts
fewer joints within 100 mm (development images)."""
WIDTH = 64  # channels in which the labels and the features of a cell are combined
STATE_WIDTH = 32  # hidden numbers of a joint from which deviation and visibility follow
SD_AT_FIRST = 0.03  # share of a crop's side, and of its depth range: 55 mm before any training
SD_RANGE = (0.001, 2.0)  # least and largest deviation, in the same units
HEAD = "joint_head."  # of the weights' names
_SURFACE = 3  # further numbers of a joint: heat within the window, share of the person, surface against joint


class JointHead(nn.Module):
    """Head that keeps hypotheses apart: a joint is placed at one peak of its heat map, not between two.

    ``places`` gives coarse maps, ``finer`` and ``correction`` add to these at twice the resolution, from
    features and label probabilities of each cell. coarse, fine, whole: channels of the two levels and of the
    whole person. classes: number of label classes.
    """

    def __init__(self, coarse: int, fine: int, whole: int, classes: int) -> None:
        super().__init__()
        self.places = nn.Conv2d(coarse, 2 * N_JOINTS, 1)
        self.finer = nn.Sequential(nn.Conv2d(fine + classes, WIDTH, 1), nn.ReLU(inplace=True))
        self.correction = nn.Conv2d(WIDTH, 2 * N_JOINTS, 1)
        self.state = _PerJoint(WIDTH + _SURFACE, whole, len(VISIBILITIES))
        self.deviation = _PerJoint(WIDTH + _SURFACE, whole, 2)
        for layer in (self.correction.weight, self.correction.bias):
            nn.init.zeros_(layer)  # type: ignore[arg-type]
        nn.init.constant_(self.deviation.bias, math.log(SD_AT_FIRST))

    def forward(
        self, levels: tuple[Tensor, Tensor], labels: Tensor, depth: Tensor, whole: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return joints, deviations, visibility scores and maps as in ``NetworkOutput``.

        levels: coarse and fine features. labels: (B, K, h, w), probabilities of the fine cells. depth: (B, 1,
        H, W), the input. whole: (B, C). Only the maps train the joints: deviations have no gradient beyond
        their own layers.
        """
        coarse, fine = levels
        features = self.finer(torch.cat([fine, labels], dim=1))
        above = nn.functional.interpolate(self.places(coarse), fine.shape[-2:], mode="bilinear")
        maps = (above + self.correction(features)).float().unflatten(1, (2, N_JOINTS))
        joints, share, certain = located(maps)
        share, place = share.detach(), joints.detach()
        around = (features.flatten(2).float() @ share.transpose(1, 2)).transpose(1, 2)
        local = torch.cat([around, certain.detach()], dim=-1)
        local = torch.cat([local, _surface(depth, share, place, fine.shape)], dim=-1)
        log_sd = self.deviation(local.detach(), whole.detach())
        return joints, log_sd.exp().clamp(*SD_RANGE), self.state(local, whole), maps


class _PerJoint(nn.Module):
    """Numbers of each joint (B, J, n) from its own features (B, J, c) and the whole person's (B, C)."""

    def __init__(self, local: int, whole: int, out: int) -> None:
        super().__init__()
        self.local = nn.Linear(local, STATE_WIDTH)
        self.context = nn.Linear(whole, N_JOINTS * STATE_WIDTH)
        self.weight = nn.Parameter(torch.randn(N_JOINTS, STATE_WIDTH, out) * 0.1 * STATE_WIDTH**-0.5)
        self.bias = nn.Parameter(torch.zeros(N_JOINTS, out))

    def forward(self, local: Tensor, whole: Tensor) -> Tensor:
        context = self.context(whole).unflatten(1, (N_JOINTS, STATE_WIDTH))
        hidden = torch.relu(self.local(local) + context)
        out: Tensor = (hidden[:, :, None] @ self.weight).squeeze(2) + self.bias
        return out


def grid_of(height: int, width: int) -> Tensor:
    """Return column and row (h * w, 2) of all cells, float32."""
    v, u = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return torch.stack([u.flatten(), v.flatten()], dim=1).float()


def _band(n: int) -> Tensor:
    """Return a matrix (n, n), 1 where row and column differ by ``PEAK`` at most."""
    cells = torch.arange(n)
    return ((cells[:, None] - cells).abs() <= PEAK).float()


def located(maps: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return joints (B, J, 3), shares of the cells (B, J, h * w), and heat within the window (B, J, 1).

    maps: heat and depth (B, 2, J, h, w). Cells weigh the exponential of their heat. A joint is the mean
    position and depth of the cells within ``WINDOW`` of the cell with the largest sum of weights within
    ``PEAK``. Heat within the window: log of its share of the softmax over all cells.
    """
    height, width = maps.shape[-2:]
    heat, depth = maps.flatten(3).unbind(1)
    odds = torch.exp(heat - heat.amax(dim=-1, keepdim=True))
    # Sums over squares by two products of matrices: pooling takes nine times as long.
    rows, columns = (_band(n).to(maps.device) for n in (height, width))
    around = (rows @ odds.detach().reshape(len(maps), -1, height, width) @ columns).flatten(2)
    grid = grid_of(height, width).to(maps.device)
    centre = grid[around.argmax(dim=-1)]
    in_columns, in_rows = (
        (torch.arange(n, device=maps.device) - centre[..., i, None]).abs() < WINDOW + 0.5
        for i, n in enumerate((width, height))
    )
    near = (in_rows[..., :, None] & in_columns[..., None, :]).flatten(2)
    within = odds * near
    total = within.sum(dim=-1, keepdim=True)
    share = within / total
    size = torch.tensor([float(width), float(height)], device=maps.device)
    places = torch.cat([(share @ grid + 0.5) / size, (share * depth).sum(dim=-1, keepdim=True)], dim=-1)
    return places, share, torch.log(total / odds.sum(dim=-1, keepdim=True))


def _surface(depth: Tensor, share: Tensor, joints: Tensor, shape: torch.Size) -> Tensor:
    """Return (B, J, 2): share of the person's pixels around a joint, and mean surface minus joint depth.

    depth: (B, 1, H, W), 0 = no person. share: (B, J, h * w). shape: of the cells, (..., h, w).
    """
    both = torch.cat([depth, (depth > 0).to(depth.dtype)], dim=1)
    cells = nn.functional.interpolate(both, shape[-2:], mode="nearest").flatten(2).transpose(1, 2).float()
    around = share @ cells
    surface, person = around[..., :1], around[..., 1:]
    return torch.cat([person, surface - joints[..., 2:] * person], dim=-1)


def with_joint_head(tensors: dict[str, Tensor], untrained: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return a network's weights with a joint head; files of release 0.3 and before hold only ``places``.

    untrained: weights of a network that was built, which complete these.
    """
    old = {name for name in tensors if name.startswith("places.")}
    if not old:
        return tensors
    kept = {f"{HEAD}{name}" if name in old else name: value for name, value in tensors.items()}
    return {name: value for name, value in untrained.items() if name.startswith(HEAD)} | kept
