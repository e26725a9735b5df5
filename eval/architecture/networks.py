"""Networks by their configuration: build, describe as JSON, restore from JSON."""

import re
from dataclasses import asdict
from typing import Any

from torch import nn

from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from eval.architecture.compact import CompactConfig, CompactUNet
from eval.architecture.reference_networks import PaperConfig, PaperFcn, SmpConfig, SmpUnet
from sensors.errors import CloudError, FormatError, fault_of

_SCHEME = "scheme"  # attribute of a network
NetworkConfig = CompactConfig | PaperConfig | SmpConfig


def build(config: NetworkConfig, scheme: Scheme = PAPER) -> nn.Module:
    """Build an untrained network: (B, 1, h, w) depth in [0, 1] -> `NetworkOutput`.

    scheme: of its classes, which ``scheme_of`` returns.
    """
    network: nn.Module
    match config:
        case CompactConfig():
            network = CompactUNet(config, scheme)
        case PaperConfig():
            network = PaperFcn(config, scheme)
        case SmpConfig():
            network = SmpUnet(config, scheme)
    vars(network)[_SCHEME] = scheme
    return network


def scheme_of(network: nn.Module, default: Scheme) -> Scheme:
    """Return the scheme of a network's classes; ``default`` for a network that ``build`` has not built."""
    scheme: Scheme = vars(network).get(_SCHEME, default)
    return scheme


def described(config: NetworkConfig) -> dict[str, Any]:
    """Return a configuration as JSON values, with the name of its class."""
    match config:
        case CompactConfig():
            return {"kind": "compact", "widths": list(config.widths), "layers": config.layers}
        case PaperConfig():
            return {"kind": "paper", **asdict(config)}
        case SmpConfig():
            return {"kind": "smp", "encoder": config.encoder, "decoder": list(config.decoder)}


def config_from(description: dict[str, Any]) -> NetworkConfig:
    """Return the configuration from its description by `described`. Raises FormatError for any other
    description.
    """
    try:
        match description:
            case {"kind": "compact", "widths": widths, "layers": layers, **rest} if not rest:
                return CompactConfig(_widths(widths), _width(layers))
            case {"kind": "paper", "base": base, "dense": dense, **rest} if not rest:
                return PaperConfig(_width(base), _width(dense))
            case {"kind": "smp", "encoder": str(encoder), "decoder": decoder, **rest} if not rest:
                return SmpConfig(_encoder(encoder), _widths(decoder))
    except (TypeError, ValueError, CloudError) as error:
        why = fault_of(error)
        raise FormatError(f"the network's description is malformed ({why}); train it again") from error
    raise FormatError(
        f"{str(description)[:200]!r} does not describe a network; use weights that 'train' wrote"
    )


def _width(value: object) -> int:
    if type(value) is not int or value < 1:
        raise ValueError(f"a width is {str(value)[:60]!r}, not a whole number from 1")
    return value


def _widths(values: object) -> tuple[int, ...]:
    if not isinstance(values, list) or not values:
        raise ValueError(f"the widths of the stages are {str(values)[:60]!r}, not a list")
    return tuple(map(_width, values))


def _encoder(name: str) -> str:
    """Return an encoder's name after a check.

    Raises ValueError for names such as ``tu-hf_hub:``, because these download files.
    """
    if not re.fullmatch("[A-Za-z0-9_-]{1,100}", name):
        raise ValueError(f"the encoder is {name[:60]!r}, not a name of letters, digits, - and _")
    return name
