"""A trained network as ONNX, for prediction without torch."""

import warnings
from pathlib import Path

import torch
from torch import Tensor, nn

from annotate.crop import SIZE
from annotate.parts import BACKGROUND, N_CLASSES
from sensors.files.atomic import replacing


class _Labeller(nn.Module):
    """Scores -> probabilities; what has no depth is background, which training leaves out."""

    background: Tensor

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network
        background = torch.zeros(1, N_CLASSES, 1, 1)
        background[0, BACKGROUND] = 1
        self.register_buffer("background", background)

    def forward(self, depth: Tensor) -> Tensor:
        """(B, 1, h, w) -> (B, 12, h, w), summing to 1."""
        probability = torch.softmax(self.network(depth), dim=1)
        return torch.where(depth > 0, probability, self.background)


def export_onnx(network: nn.Module, path: Path) -> None:
    """Write the network as ONNX: ``depth`` (B, 1, 212, 212) -> ``probability`` (B, 12, 212, 212)."""
    whole = _Labeller(network.cpu()).eval()
    with replacing(path) as temporary, warnings.catch_warnings():
        # The newer exporter needs another package, onnxscript, and gains nothing here.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            whole,
            (torch.rand(1, 1, SIZE, SIZE),),
            temporary,
            input_names=["depth"],
            output_names=["probability"],
            dynamic_axes={"depth": {0: "batch"}, "probability": {0: "batch"}},
            dynamo=False,
        )
