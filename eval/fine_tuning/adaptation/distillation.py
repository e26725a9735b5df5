"""Distance between the outputs of a network and the outputs of the network that it started from.

Source: Li & Hoiem, Learning without forgetting, ECCV 2016.
"""

import torch
from torch import Tensor, nn

from eval.architecture.blocks import NetworkOutput
from eval.training.plan import ModernRecipe


def distance(output: NetworkOutput, known: NetworkOutput, depth: Tensor, recipe: ModernRecipe) -> Tensor:
    """Return the distance of outputs from known ones for depth (B, 1, h, w); each term weighs as in training.

    Probabilities differ by their Kullback-Leibler divergence, in the mean over pixels with depth, joints and
    images.
    """
    seen = (depth[:, 0] > 0).float()
    parts = _divergence(output.scores, known.scores, 1)
    apart = (parts * seen).sum() / seen.sum().clamp(min=1)
    if output.facing is None or known.facing is None or output.posture is None or known.posture is None:
        return apart
    apart = apart + recipe.facing * (output.facing.float() - known.facing.float()).square().mean()
    apart = apart + recipe.posture * _divergence(output.posture, known.posture, 1).mean()
    return apart + _of_joints(output, known, recipe)


def _of_joints(output: NetworkOutput, known: NetworkOutput, recipe: ModernRecipe) -> Tensor:
    """Return the distance of joints: heat maps, depth maps, deviations and visibility."""
    assert output.joint_maps is not None and known.joint_maps is not None
    assert output.joint_sd is not None and known.joint_sd is not None
    assert output.joint_state is not None and known.joint_state is not None
    (heat, depth), (known_heat, known_depth) = (
        maps.float().flatten(3).unbind(1) for maps in (output.joint_maps, known.joint_maps)
    )
    share, weights = torch.softmax(known_heat, dim=-1), recipe.joints
    sd = (output.joint_sd.float().log() - known.joint_sd.float().log()).square()
    return (
        weights.heat * _divergence(heat, known_heat, -1).mean()
        + weights.depth * (share * (depth - known_depth).abs()).sum(dim=-1).mean()
        + weights.deviation * sd.mean()
        + weights.state * _divergence(output.joint_state, known.joint_state, -1).mean()
    )


def _divergence(scores: Tensor, known: Tensor, dim: int) -> Tensor:
    """Return the divergence of the softmax of scores from the softmax of known scores, without ``dim``."""
    own, other = (torch.log_softmax(one.float(), dim) for one in (scores, known))
    return nn.functional.kl_div(own, other, reduction="none", log_target=True).sum(dim)
