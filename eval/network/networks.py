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
from eval.network.compact import CompactConfig, CompactUNet
from eval.network.reference_networks import PaperConfig, PaperFcn, SmpConfig, SmpUnet
from sensors.errors import CloudError, FormatError
from sensors.files.atomic import replacing

NetworkConfig = CompactConfig | PaperConfig | SmpConfig


def build(config: NetworkConfig) -> nn.Module:
    """The untrained network: (B, 1, h, w) depth in [0, 1] -> `Answer`."""
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
            return {"kind": "compact", "widths": list(config.widths), "layers": config.layers}
        case PaperConfig():
            return {"kind": "paper", **asdict(config)}
        case SmpConfig():
            return {"kind": "smp", "encoder": config.encoder, "decoder": list(config.decoder)}


def config_from(description: dict[str, Any]) -> NetworkConfig:
    """Inverse of `described`. Raises FormatError when it does not describe a network."""
    try:
        match description:
            case {"kind": "compact", "widths": widths, "layers": layers, **rest} if not rest:
                return CompactConfig(_widths(widths), _width(layers))
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
    """Scores -> probabilities; what has no depth is background, which training leaves out.

    Behind them facing, posture's probabilities and joints, of a network that gives them.
    """

    background: Tensor

    def __init__(self, network: nn.Module, temperature: float) -> None:
        super().__init__()
        self.network, self.temperature = network, temperature
        background = torch.zeros(1, N_CLASSES, 1, 1)
        background[0, BACKGROUND] = 1
        self.register_buffer("background", background)

    def forward(self, depth: Tensor) -> tuple[Tensor, ...]:
        """(B, 1, h, w) -> (B, 12, h, w), summing to 1; (B, 2), (B, P), (B, J, 3)."""
        scores, facing, posture, joints = self.network(depth)
        # A softmax written out: ONNX Runtime's own along this axis takes five times as long.
        odds = torch.exp((scores - scores.amax(dim=1, keepdim=True)) / self.temperature)
        parts = torch.where(depth > 0, odds / odds.sum(dim=1, keepdim=True), self.background)
        if facing is None:
            return (parts,)
        return parts, facing, torch.softmax(posture, dim=1), joints


def export_onnx(network: nn.Module, path: Path, temperature: float = 1.0) -> None:
    """Write the network as ONNX: ``depth`` (B, 1, 212, 212) -> ``probability`` (B, 12, 212, 212).

    And, of a network that gives them, ``facing``, ``posture``, ``joints`` as `Answer` has them. temperature:
    divides the scores (`eval.training.temperature`).
    """
    whole = _Labeller(network.cpu(), temperature).eval()
    example = torch.rand(1, 1, SIZE, SIZE)
    with torch.no_grad():
        names = ["probability", "facing", "posture", "joints"][: len(whole(example))]
    with replacing(path) as temporary, warnings.catch_warnings():
        # The newer exporter needs another package, onnxscript, and gains nothing here.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            whole,
            (example,),
            temporary,
            input_names=["depth"],
            output_names=names,
            dynamic_axes={name: {0: "batch"} for name in ("depth", *names)},
            dynamo=False,
        )
