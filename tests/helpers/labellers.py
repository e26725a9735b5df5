"""Labellers for tests."""

from collections.abc import Callable

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.parts import PAPER
from annotate.person.extract import PersonMask
from annotate.segmentation.segmented_person import unlabelled


class CloudLabeller:
    """Labeller by a function of a whole cloud and the previous frame's labels."""

    fuser, scheme = Fuser, PAPER

    def __init__(self, label: Callable) -> None:
        self.label = label

    def detect(self, cloud):
        return cloud


def no_person(cloud, before=None):
    """Label a frame without a person."""
    mask = np.zeros(cloud.depth_mm.shape, bool)
    return unlabelled(mask), PersonMask(mask, "depth", mask.astype(np.uint8))
