"""Networks by their configuration: what there is, and how one is built, described and read back."""

import re
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from annotate.crop import SIZE
from annotate.parts import BACKGROUND, N_CLASSES
from eval.network.architectures import CompactConfig, CompactUNet, PaperConfig, PaperFcn, SmpConfig, SmpUnet
from sensors.errors import CloudError, FormatError
from sensors.files.atomic import replacing

NetworkConfig = CompactConfig | PaperConfig | SmpConfig


def build(config: NetworkConfig) -> nn.Module:
    """The untrained network: (B, 1, h, w) depth in [0, 1] -> (B, 12, h, w) class scores."""
    match config:
        case CompactConfig():
            return CompactUNet(config)
        case PaperConfig():
            return PaperFcn(config)
        case SmpConfig():
            return SmpUnet(config)


def described(config: NetworkConfig) -> dict[str, Any]:
    """A configuration as JSON values, with its kind."""
    match config:
        case CompactConfig():
            return {"kind": "compact", "widths": list(config.widths)}
        case PaperConfig():
            return {"kind": "paper", **asdict(config)}
        case SmpConfig():
            return {"kind": "smp", "encoder": config.encoder, "decoder": list(config.decoder)}


def config_from(description: dict[str, Any]) -> NetworkConfig:
    """Inverse of `described`. Raises FormatError when it does not describe a network."""
    try:
        match description:
            case {"kind": "compact", "widths": widths, **rest} if not rest:
                return CompactConfig(_widths(widths))
            case {"kind": "paper", "base": base, "dense": dense, **rest} if not rest:
                return PaperConfig(_width(base), _width(dense))
            case {"kind": "smp", "encoder": str(encoder), "decoder": decoder, **rest} if not rest:
                return SmpConfig(_encoder(encoder), _widths(decoder))
    except (TypeError, ValueError, CloudError) as error:
        raise FormatError(f"the network's description is malformed ({error}); train it again") from error
    raise FormatError(
        f"{str(description)[:200]!r} does not describe a network; use weights that 'train' wrote"
    )


def _width(value: Any) -> int:  # noqa: ANN401 - it comes from a file
    if type(value) is not int or value < 1:
        raise ValueError(f"{str(value)[:60]!r} channels; give a number from 1")
    return value


def _widths(values: Any) -> tuple[int, ...]:  # noqa: ANN401 - it comes from a file
    if not isinstance(values, list) or not values:
        raise ValueError(f"{str(values)[:60]!r} as stages; give a list of their widths")
    return tuple(map(_width, values))


def _encoder(name: str) -> str:
    """An encoder of the library's own: ``tu-hf_hub:`` and the like would fetch one from the network."""
    if not re.fullmatch("[A-Za-z0-9_-]{1,100}", name):
        raise ValueError(f"encoder {name[:60]!r}; give a name of letters, digits, - and _")
    return name


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
