"""Network between two networks, which keeps more of the first one's abilities than the second one.

Source: Wortsman et al., Robust fine-tuning of zero-shot models, CVPR 2022.
"""

from copy import deepcopy
from typing import TypeVar

import torch
from torch import nn

N = TypeVar("N", bound=nn.Module)


def between(first: nn.Module, last: N, share: float) -> N:
    """Return the network at a share of the way from the first to the last one, of the same shape."""
    network, start = deepcopy(last), first.state_dict()
    with torch.no_grad():
        for name, value in network.state_dict().items():
            if value.is_floating_point():
                value.lerp_(start[name], 1 - share)
    return network
