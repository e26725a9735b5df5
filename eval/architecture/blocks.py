"""Building blocks that the networks share, and the output of a network for a crop."""

from typing import NamedTuple

import torch
from torch import Tensor, nn


class NetworkOutput(NamedTuple):
    """Class scores (B, K, h, w) of a batch of crops; from some networks also facing, posture and joints.

    facing: (B, 2), cosine and sine of the camera's azimuth about the trunk, 0 in front of the chest, positive
    on the person's left; the length is the certainty. posture: (B, P), scores by ``POSTURES``. joints: (B,
    15, 3) by ``JOINT_NAMES``, column and row as shares of the crop's side, depth in the crop's units (1 =
    2000 mm). joint_sd: (B, 15, 2), root mean square error of a joint in the image, in shares of the side, and
    in depth, in the crop's units. joint_state: (B, 15, 3), scores by ``VISIBILITIES``, outside = beyond the
    crop. joint_maps: (B, 2, 15, h', w'), heat (scores of the cells) and depth, to train on.
    """

    scores: Tensor
    facing: Tensor | None = None
    posture: Tensor | None = None
    joints: Tensor | None = None
    joint_sd: Tensor | None = None
    joint_state: Tensor | None = None
    joint_maps: Tensor | None = None


def convolution(c_in: int, c_out: int, side: int = 3, pad: int = 1, stride: int = 1) -> nn.Sequential:
    """Return layers: convolution (side x side), batch normalisation, ReLU."""
    return nn.Sequential(
        nn.Conv2d(c_in, c_out, side, stride, pad, bias=False), nn.BatchNorm2d(c_out), nn.ReLU(inplace=True)
    )


def self_attention(projected: Tensor, shape: torch.Size, heads: int) -> Tensor:
    """Return multi-head attention of shape (B, N, C) from joined queries, keys and values (B, N, 3 C).

    Plain operations are used, because N is small and the exported graph stays simple. Source: Vaswani et al.
    2017.
    """
    batch, count, width = shape
    query, key, value = (
        part.reshape(batch, count, heads, -1).transpose(1, 2) for part in projected.chunk(3, dim=-1)
    )
    weights = torch.softmax(query @ key.transpose(2, 3) / (width // heads) ** 0.5, dim=-1)
    return (weights @ value).transpose(1, 2).reshape(batch, count, width)
