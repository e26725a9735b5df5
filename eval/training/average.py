"""The moving average of a network's weights, which is measured and shipped: smoother than any one of them."""

from copy import deepcopy

import torch
from torch import nn

WARM_STEPS = 10.0
"""Steps after which the average begins to reach further back than half of them; chosen by eye."""


class Average:
    """Moving average of a network's weights and statistics. model: the network with these.

    decay: share that a step leaves of the average, once there are steps enough; 0 is the network itself.
    """

    def __init__(self, model: nn.Module, decay: float) -> None:
        self.model = deepcopy(model) if decay else model
        self._decay = decay

    @torch.no_grad()
    def add(self, model: nn.Module, step: int) -> None:
        """Take in a network after its step number ``step``, from 1."""
        if self.model is model:
            return
        share = 1 - min(self._decay, step / (step + WARM_STEPS))
        new = model.state_dict()
        for name, value in self.model.state_dict().items():
            if value.is_floating_point():
                value.lerp_(new[name], share)
            else:
                value.copy_(new[name])
