"""Weights as safetensors, with a description of their network; reading them executes no code."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from annotate.scheme.scheme_file import scheme_from_fields, scheme_to_fields
from eval.architecture.joint_head import with_joint_head
from eval.architecture.networks import NetworkConfig, build, config_from, described
from eval.architecture.reference_networks import SmpConfig
from sensors.errors import CloudError, FormatError, fault_of
from sensors.files.atomic import replacing
from sensors.files.bounded import check_file


class Weights(NamedTuple):
    """Network of a weights file, its configuration and the scheme of its classes."""

    model: nn.Module
    config: NetworkConfig
    scheme: Scheme


def save_weights(path: Path, model: nn.Module, config: NetworkConfig, scheme: Scheme = PAPER) -> None:
    """Write a network's weights with its description, atomically. Raises CloudError on a full disk.

    The scheme is written whole; a file without one is of ``paper``.
    """
    # One entry: safetensors writes several in an order that changes from run to run.
    network = {**described(config), "classes": len(scheme.class_ids)}
    network |= {} if scheme == PAPER else {"scheme": scheme_to_fields(scheme)}
    write_tensors(path, model.state_dict(), {"network": json.dumps(network)})


def load_weights(path: Path) -> Weights:
    """Build the network that a weights file describes and fill it.

    Raises FormatError where the file is not a weights file, is cut off, or has another number of classes than
    its scheme.
    """
    tensors, meta = read_tensors(path)
    if "network" not in meta:
        raise FormatError(f"{path} does not hold weights; give a weights.safetensors that 'train' wrote")
    try:
        description = json.loads(meta["network"])
        classes = description.pop("classes")
        scheme = scheme_from_fields(description.pop("scheme")) if "scheme" in description else PAPER
        config = config_from(description)
    except (ValueError, RecursionError, AttributeError, KeyError, TypeError, IndexError) as error:
        raise FormatError(
            f"{path} does not describe a network ({fault_of(error)}); train it again"
        ) from error
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from error
    if classes != len(scheme.class_ids):
        raise FormatError(
            f"{path} is for {classes!r} classes, not {len(scheme.class_ids)} as scheme {scheme.name!r}; "
            "train it again"
        )
    _check_size(path, config, scheme, tensors)
    # Layers that an older file lacks are drawn at random; a training that resumes needs the same ones.
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        model = build(config, scheme)
    tensors = with_joint_head(tensors, model.state_dict())
    check_fits(path, model, tensors)
    model.load_state_dict(tensors)
    return Weights(model, config, scheme)


def _check_size(path: Path, config: NetworkConfig, scheme: Scheme, tensors: dict[str, Tensor]) -> None:
    """Raise FormatError where the file lacks weights of the network; runs before memory is allocated."""
    if isinstance(config, SmpConfig):
        # Not all of its encoders can be outlined. Each stage of its decoder has a 3x3 of its own width.
        if sum(9 * width**2 for width in config.decoder) > sum(t.numel() for t in tensors.values()):
            raise FormatError(f"{path} lacks the weights of its decoder {config.decoder}; train it again")
        return
    try:
        with torch.device("meta"):
            outline = build(config, scheme)
    except RuntimeError as error:
        raise FormatError(f"{path} describes a network of impossible size; train it again") from error
    check_fits(path, outline, with_joint_head(tensors, outline.state_dict()))


def check_fits(path: Path, model: nn.Module, tensors: dict[str, Tensor]) -> None:
    """Raise FormatError that names the first tensor that is missing, unexpected or of another shape."""
    expected = model.state_dict()
    for name in sorted(expected.keys() | tensors.keys()):
        theirs, ours = (tuple(t[name].shape) if name in t else None for t in (tensors, expected))
        if theirs is None:
            raise FormatError(f"{path} lacks the weights {name} of the network; train it again")
        if ours is None:
            raise FormatError(f"{path} has weights {name}, which the network lacks; train it again")
        if theirs != ours:
            raise FormatError(f"{path} has {name} of shape {theirs}, the network {ours}; train it again")


def write_tensors(path: Path, tensors: dict[str, Tensor], meta: dict[str, str]) -> None:
    """Write a safetensors file atomically. Raises CloudError on a full disk."""
    try:
        with replacing(path) as temporary:
            save_file({name: value.contiguous() for name, value in tensors.items()}, temporary, meta)
    except SafetensorError as error:
        raise CloudError(
            f"{path} cannot be written ({error}); free some space and run the same command again"
        ) from error


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Return the tensors and the metadata of a safetensors file. Raises FormatError where it is not such a
    file or is cut off.
    """
    check_file(path, "give weights that train wrote")
    try:
        with safe_open(path, framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except (OSError, SafetensorError, ValueError, RuntimeError) as error:
        raise FormatError(f"{path} cannot be read as a safetensors file ({error}); train it again") from error
