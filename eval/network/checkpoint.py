"""Weights and unfinished trainings as safetensors: they know their network, reading them executes nothing."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from annotate.parts import N_CLASSES
from eval.network.networks import NetworkConfig, build, config_from, described
from eval.network.reference_networks import SmpConfig
from sensors.errors import CloudError, FormatError
from sensors.files.atomic import replacing


@dataclass(frozen=True)
class Point:
    """The mean training loss per pixel since the point before, and the images seen by then."""

    images: int
    loss: float


@dataclass(frozen=True)
class Epoch:
    """Results of an epoch: mean training loss; mean recall and mIoU of the parts on measured frames.

    number counts from 1. The scores are None when nothing is measured. seconds: the training's so far.
    """

    number: int
    loss: float
    mean_recall: float | None
    miou: float | None
    seconds: float


@dataclass
class Progress:
    """Progress of a training: steps done, losses not yet summed up in `points` and `epochs`, seconds."""

    step: int = 0
    since_point: list[float] = field(default_factory=list)
    epoch_loss: float = 0.0
    points: list[Point] = field(default_factory=list)
    epochs: list[Epoch] = field(default_factory=list)
    seconds: float = 0.0


def save_checkpoint(
    path: Path, model: nn.Module, average: nn.Module, optimizer: torch.optim.Optimizer, progress: Progress
) -> None:
    """Write all that a training needs to go on, atomically. Raises CloudError where the disk refuses it."""
    tensors = {f"model.{name}": value.contiguous() for name, value in model.state_dict().items()}
    if average is not model:
        tensors |= {f"average.{name}": value.contiguous() for name, value in average.state_dict().items()}
    for index, entry in optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{index}.{name}": value.contiguous() for name, value in entry.items()}
    _write(path, tensors, {"progress": json.dumps(asdict(progress))})


def load_checkpoint(
    path: Path, model: nn.Module, average: nn.Module, optimizer: torch.optim.Optimizer
) -> Progress:
    """Put model, average and optimizer where they were. Raises FormatError when it is no such checkpoint."""
    try:
        tensors, meta = _read(path)
        for prefix, network in (("model.", model), ("average.", average))[: 1 if average is model else 2]:
            own = {n.removeprefix(prefix): value for n, value in tensors.items() if n.startswith(prefix)}
            check_fits(path, network, own)
            network.load_state_dict(own)
        optimizer.load_state_dict({**optimizer.state_dict(), "state": _optimizer_state(tensors)})
        fields = json.loads(meta["progress"])
        fields["points"] = [Point(**point) for point in fields["points"]]
        fields["epochs"] = [Epoch(**epoch) for epoch in fields["epochs"]]
        return Progress(**fields)
    except (ValueError, KeyError, RuntimeError, TypeError, FormatError) as error:
        raise _unusable(path, error) from error


def saved_work(path: Path) -> tuple[int, float]:
    """Return the steps and the seconds of the training that a checkpoint holds.

    Raises FormatError when the file is no checkpoint.
    """
    try:
        with safe_open(path, framework="pt") as file:
            progress = json.loads(file.metadata()["progress"])
        return int(progress["step"]), float(progress["seconds"])
    except (OSError, SafetensorError, ValueError, KeyError, TypeError) as error:
        raise _unusable(path, error) from error


def _unusable(path: Path, error: Exception) -> FormatError:
    reason = str(error).partition("\n")[0] or type(error).__name__
    return FormatError(f"checkpoint {path} cannot be resumed ({reason}); remove it or choose another folder")


def save_weights(path: Path, model: nn.Module, config: NetworkConfig) -> None:
    """Write a network's weights with its description, atomically. Raises CloudError as a checkpoint does."""
    tensors = {name: value.contiguous() for name, value in model.state_dict().items()}
    # One entry: safetensors writes several in an order that changes from run to run.
    meta = {"network": json.dumps({**described(config), "classes": N_CLASSES})}
    _write(path, tensors, meta)


def load_weights(path: Path) -> tuple[nn.Module, NetworkConfig]:
    """Build the network that a weights file describes and fill it.

    Raises FormatError when the file is none, is cut off, or is for another number of classes.
    """
    tensors, meta = _read(path)
    if "network" not in meta:
        raise FormatError(f"{path} holds no network's weights; give a weights.safetensors that 'train' wrote")
    try:
        description = json.loads(meta["network"])
        classes = description.pop("classes")
        config = config_from(description)
    except (ValueError, RecursionError, AttributeError, KeyError, TypeError, IndexError) as error:
        raise FormatError(f"{path} does not describe a network ({error!r}); train it again") from error
    if classes != N_CLASSES:
        raise FormatError(f"{path} is for {classes!r} classes, not {N_CLASSES}; train it again")
    _check_size(path, config, tensors)
    model = build(config)
    check_fits(path, model, tensors)
    model.load_state_dict(tensors)
    return model, config


def _check_size(path: Path, config: NetworkConfig, tensors: dict[str, Tensor]) -> None:
    """Raise FormatError where a network needs weights that the file has not, before they get memory."""
    if isinstance(config, SmpConfig):
        # Not all of its encoders can be outlined. Each stage of its decoder has a 3x3 of its own width.
        if sum(9 * width**2 for width in config.decoder) > sum(t.numel() for t in tensors.values()):
            raise FormatError(f"{path} lacks the weights of its decoder {config.decoder}; train it again")
        return
    try:
        with torch.device("meta"):
            outline = build(config)
    except RuntimeError as error:
        raise FormatError(f"{path} describes a network of impossible size; train it again") from error
    check_fits(path, outline, tensors)


def check_fits(path: Path, model: nn.Module, tensors: dict[str, Tensor]) -> None:
    """Raise FormatError naming the first tensor that a model lacks, misses or has in another shape."""
    expected = model.state_dict()
    for name in sorted(expected.keys() | tensors.keys()):
        theirs, ours = (tuple(t[name].shape) if name in t else None for t in (tensors, expected))
        if theirs != ours:
            raise FormatError(f"{path} has {name} of shape {theirs}, the network {ours}; train it again")


def _write(path: Path, tensors: dict[str, Tensor], meta: dict[str, str]) -> None:
    """Raises CloudError where the disk refuses it: safetensors' own error is none of the system's."""
    try:
        with replacing(path) as temporary:
            save_file(tensors, temporary, meta)
    except SafetensorError as error:
        raise CloudError(
            f"{path} cannot be written ({error}); free some space and run the same command again"
        ) from error


def _read(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    try:
        with safe_open(path, framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except (OSError, SafetensorError, ValueError, RuntimeError) as error:
        raise FormatError(
            f"{path} is not a safetensors file or is cut off ({error}); train it again"
        ) from error


def _optimizer_state(tensors: dict[str, Tensor]) -> dict[int, dict[str, Tensor]]:
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith("optimizer."):
            _, index, key = name.split(".", 2)
            state.setdefault(int(index), {})[key] = value
    return state
