"""Networks by their configuration: what there is, and how one is built, described and read back."""

from dataclasses import asdict
from typing import Any

from torch import nn

from eval.compact import CompactConfig, CompactUNet
from sensors.errors import FormatError

NetworkConfig = CompactConfig


def build(config: NetworkConfig) -> nn.Module:
    """The untrained network: (B, 1, h, w) depth in [0, 1] -> (B, 12, h, w) class scores."""
    match config:
        case CompactConfig():
            return CompactUNet(config)


def described(config: NetworkConfig) -> dict[str, Any]:
    """A configuration as JSON values, with its kind."""
    match config:
        case CompactConfig():
            return {"kind": "compact", **asdict(config), "widths": list(config.widths)}


def config_from(description: dict[str, Any]) -> NetworkConfig:
    """Inverse of `described`. Raises FormatError when it describes no network."""
    try:
        fields = dict(description)
        match fields.pop("kind"):
            case "compact":
                return CompactConfig(tuple(int(w) for w in fields.pop("widths")))
            case kind:
                raise FormatError(f"network kind {kind!r} is unknown; use weights that 'train' wrote")
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"the network's description is malformed ({error!r}); train it again") from error
