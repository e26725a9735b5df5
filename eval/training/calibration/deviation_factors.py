"""Calibration of a network's joint deviations after the training: a factor for each visibility."""

import numpy as np
import torch
from torch import nn

from annotate.array_types import Float32, Float64, UInt8
from eval.architecture.blocks import NetworkOutput
from eval.architecture.networks import scheme_of
from eval.network.flip_averaging import averaged, flipped_back
from eval.scores.joint_visibility import VISIBILITIES
from eval.scores.joints import N_JOINTS
from eval.training.body_targets import JOINTS
from eval.training.calibration.confidence_temperature import BATCH
from eval.training.crops import Crops
from eval.training.joint_loss import JointTargets
from eval.training.progress import Advance, unseen

WITHIN = 0.683  # share of a normal distribution within one standard deviation
LEAST_JOINTS = 100  # known joints of a visibility from which its factor is fitted; untuned
UNCHANGED = (1.0,) * len(VISIBILITIES)


def fitted_deviation_factors(model: nn.Module, crops: Crops, advance: Advance = unseen) -> tuple[float, ...]:
    """Return factors by ``VISIBILITIES`` with which 68 % of the joints lie within one deviation.

    Outputs are averaged over an image and its flip. A crop's side counts as its depth range, because a crop
    has no camera. 1 for networks without deviations, and below ``LEAST_JOINTS``. advance: called with the
    number of finished crops.
    """
    known = list[tuple[Float64, UInt8]]()
    for k, (depth, _) in enumerate(crops.batches(BATCH)):
        if (pair := _ratios(model, depth, crops, BATCH * k)) is not None:
            known.append(pair)
        advance(len(depth))
    if not known:
        return UNCHANGED
    ratios, states = (np.concatenate(column) for column in zip(*known, strict=True))
    groups = [ratios[states == i] for i in range(len(VISIBILITIES))]
    return tuple(float(np.quantile(own, WITHIN)) if len(own) >= LEAST_JOINTS else 1.0 for own in groups)


def _ratios(model: nn.Module, depth: Float32, crops: Crops, start: int) -> tuple[Float64, UInt8] | None:
    """Return errors of known joints over their deviations (n,), and their visibility (n,); None without."""
    model.eval()
    device, twins = next(model.parameters()).device, scheme_of(model, crops.scheme).twin_classes
    x = torch.from_numpy(depth[:, None]).to(device)
    with torch.no_grad():
        own, other = (_outputs(model(images)) for images in (x, x.flip(-1)))
    if len(own) == 1:
        return None
    *_, joints, sd, _ = averaged(own, flipped_back(other, twins), twins)
    truth = torch.from_numpy(crops.wholes[start : start + len(depth), JOINTS].reshape(-1, N_JOINTS, 3))
    targets = JointTargets.of(truth, torch.from_numpy(depth[:, None]))
    ratios = np.linalg.norm(joints - targets.joints.numpy(), axis=-1) / np.linalg.norm(sd, axis=-1)
    known = targets.known.numpy()
    return ratios[known].astype(np.float64), targets.states.numpy()[known].astype(np.uint8)


def _outputs(output: NetworkOutput) -> list[Float32]:
    """Return the outputs in the order of ``flip_averaging``, one pixel of the scores; alone without
    deviations.
    """
    scores, facing, posture, joints, sd, states, _ = output
    kept = [scores[..., :1, :1]]
    if sd is not None and states is not None:
        kept += [one for one in (facing, posture, joints, sd, states) if one is not None]
    return [one.float().cpu().numpy() for one in kept]
