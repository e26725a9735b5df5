"""Answer of a network for a crop: class scores, and facing, posture and joints of the whole person."""

from typing import NamedTuple

from torch import Tensor


class Answer(NamedTuple):
    """Scores (B, 12, h, w) of a batch of crops, and of networks that give them:

    facing: (B, 2) cosine and sine of the camera's azimuth about the trunk, 0 before the chest, positive on
    the person's left; its length is the network's certainty. posture: (B, P) scores by
    ``annotate.posture.POSTURES``. joints: (B, 15, 3) by ``eval.scores.joints.JOINT_NAMES``: column and row as
    shares of the crop's side, depth in the crop's units.
    """

    scores: Tensor
    facing: Tensor | None = None
    posture: Tensor | None = None
    joints: Tensor | None = None
