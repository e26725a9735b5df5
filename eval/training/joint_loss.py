"""Loss of the joint head: heat maps, depth maps, deviations and visibility."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from annotate.crop import RANGE_MM
from eval.architecture.blocks import NetworkOutput
from eval.architecture.joint_head import grid_of
from eval.scores.joint_visibility import BEHIND_MM, OUTSIDE, REACHES_MM

SPREAD = 0.02  # of the crop's side: Gaussian around a true place, 4 px of 212; untuned
RIGHT = 0.08  # of the crop's side: a joint this near is at the right peak; untuned


@dataclass(frozen=True)
class JointWeights:
    """Weights in the loss, beside 1 for the parts; by trials (docs/adr/0029).

    heat: cross entropy of heat maps. place: absolute error in the image of joints at the right peak. depth:
    absolute error of depth maps. deviation: negative log likelihood. state: cross entropy of visibility.
    """

    heat: float = 0.3
    place: float = 2.0
    depth: float = 3.0
    deviation: float = 0.05
    state: float = 0.1


@dataclass(frozen=True, eq=False)
class JointTargets:
    """True joints of crops.

    joints: (B, J, 3) as ``NetworkOutput.joints``. known: bool (B, J), place and depth. inside: bool (B, J),
    place known and within the crop. states: int64 (B, J), ids of ``VISIBILITIES`` where known.
    """

    joints: Tensor
    known: Tensor
    inside: Tensor
    states: Tensor

    @classmethod
    def of(cls, joints: Tensor, depth: Tensor) -> "JointTargets":
        """Return the targets from joints, NaN = unknown, and the input depth (B, 1, h, w)."""
        known, placed = (torch.isfinite(joints[..., :n]).all(dim=-1) for n in (3, 2))
        joints = joints.nan_to_num(0)
        within = (joints[..., :2] - 0.5).abs().amax(dim=-1) < 0.5
        height, width = depth.shape[-2:]
        cell = (joints[..., :2] * torch.tensor([width, height], device=depth.device)).long()
        u, v = cell[..., 0].clamp(0, width - 1), cell[..., 1].clamp(0, height - 1)
        reading = depth.flatten(1).gather(1, v * width + u)
        in_front_mm = RANGE_MM * (joints[..., 2] - reading)
        near = (in_front_mm <= joints.new_tensor(REACHES_MM)) & (in_front_mm >= -BEHIND_MM)
        states = torch.where(within, (near & (reading > 0)).long(), OUTSIDE)
        return cls(joints, known, placed & within, states)


def joint_losses(
    output: NetworkOutput, targets: JointTargets, weights: JointWeights
) -> list[tuple[Tensor, Tensor]]:
    """Return weighted losses of joints, each (B, J) with the joints (B, J) that it counts."""
    assert output.joints is not None and output.joint_sd is not None
    assert output.joint_state is not None and output.joint_maps is not None
    heat, depth = output.joint_maps.float().flatten(3).unbind(1)
    share = _shares(targets.joints, output.joint_maps.shape)
    entropy = torch.special.entr(share).sum(dim=-1)
    crossed = -(share * torch.log_softmax(heat, dim=-1)).sum(dim=-1) - entropy
    off = (share * (depth - targets.joints[..., 2:]).abs()).sum(dim=-1)
    missed = output.joints.float() - targets.joints
    near = missed[..., :2].abs().sum(dim=-1)
    right = targets.inside & (near < RIGHT)
    missed = missed.detach()
    squared = torch.stack([missed[..., :2].square().sum(dim=-1), missed[..., 2].square()], dim=-1)
    sd = output.joint_sd.float()
    unlikely = (sd.log() + squared / (2 * sd.square())).sum(dim=-1)
    states = output.joint_state.float().transpose(1, 2)
    named = nn.functional.cross_entropy(states, targets.states, reduction="none")
    return [
        (weights.heat * crossed, targets.inside),
        (weights.place * near, right),
        (weights.depth * off, targets.inside & targets.known),
        (weights.deviation * unlikely, targets.known),
        (weights.state * named, targets.known),
    ]


def _shares(joints: Tensor, shape: torch.Size) -> Tensor:
    """Return shares (B, J, h * w) of a Gaussian around each joint, sum 1. shape: of the maps."""
    height, width = shape[-2:]
    size = torch.tensor([float(width), float(height)], device=joints.device)
    cells = (grid_of(height, width).to(joints.device) + 0.5) / size
    away = (cells - joints[:, :, None, :2]).square().sum(dim=-1)
    return torch.softmax(-away / (2 * SPREAD**2), dim=-1)
