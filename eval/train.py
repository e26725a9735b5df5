"""Train a network on labelled frames: resumable, deterministic given a seed, watched while it runs."""

import json
import math
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from zlib import crc32

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from annotate.parts import N_CLASSES, UNDEFINED
from eval.data import Crops, batches
from eval.metrics import confusion_matrix, mean_recall, miou
from eval.networks import CompactUNet
from sensors.atomic import replacing, write_bytes
from sensors.errors import ExistsError, FormatError

CLASS_WEIGHT_BACKGROUND = 0.3
"""Background is easy and everywhere: it would drown the parts in the mean loss."""


@dataclass(frozen=True)
class Schedule:
    """AdamW with one cycle of the learning rate over all epochs."""

    epochs: int = 12
    batch: int = 16
    peak_rate: float = 6e-3
    weight_decay: float = 1e-4
    seed: int = 0


@dataclass(frozen=True)
class Epoch:
    """What an epoch came to: mean training loss, and on held-out frames mean recall and mIoU of the parts."""

    number: int
    loss: float
    mean_recall: float
    miou: float
    seconds: float


def train(
    crops: Crops, held_out: Crops, out: Path, schedule: Schedule, report: Callable[[Epoch], None]
) -> tuple[CompactUNet, list[Epoch]]:
    """Train the compact network; each epoch ends in a checkpoint in ``out`` from which the same call goes on.

    Raises ExistsError when ``out`` was started otherwise, FormatError on a broken checkpoint.
    """
    _claim(out, schedule, crops)
    torch.manual_seed(schedule.seed)
    model = CompactUNet().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = torch.optim.AdamW(model.parameters(), schedule.peak_rate, weight_decay=schedule.weight_decay)
    history = _resume(out, model, optimizer)
    for number in range(len(history), schedule.epochs):
        started = time.monotonic()
        rng = np.random.default_rng((schedule.seed, number))
        loss = _epoch(model, optimizer, crops, schedule, number, rng)
        matrix = evaluate(model, held_out)
        scores = float(mean_recall(matrix)), float(miou(matrix))
        history.append(Epoch(number, loss, *scores, time.monotonic() - started))
        _save(out, model, optimizer, history)
        report(history[-1])
    return model, history


def one_cycle(share: float) -> float:
    """Learning rate at a share in [0, 1] of the training, as a factor of its peak.

    Source: Smith & Topin 2018: up by a cosine from 1/25 over the first 30 %, then down to almost nothing.
    """
    up = 0.3
    if share < up:
        return 0.04 + 0.96 * (1 - math.cos(math.pi * share / up)) / 2
    return 1e-4 + (1 - 1e-4) * (1 + math.cos(math.pi * (share - up) / (1 - up))) / 2


def _epoch(model: nn.Module, optimizer: torch.optim.Optimizer, crops: Crops, schedule: Schedule, number: int,
           rng: np.random.Generator) -> float:  # fmt: skip
    model.train()
    steps = max(1, len(crops) // schedule.batch)
    weight = torch.ones(N_CLASSES)
    weight[0] = CLASS_WEIGHT_BACKGROUND
    losses = []
    for step, (x, y) in enumerate(batches(crops, schedule.batch, rng)):
        for group in optimizer.param_groups:
            group["lr"] = schedule.peak_rate * one_cycle((number + step / steps) / schedule.epochs)
        scores = model(torch.from_numpy(x).contiguous(memory_format=torch.channels_last))
        loss = nn.functional.cross_entropy(
            scores, torch.from_numpy(y.astype(np.int64)), weight, ignore_index=UNDEFINED
        )
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        losses.append(float(loss.detach()))
    return float(np.mean(losses))


@torch.no_grad()
def evaluate(model: nn.Module, crops: Crops, batch: int = 32) -> NDArray[np.int64]:
    """Confusion matrix (12, 12) of a network on crops, rows are the truth."""
    model.eval()
    total = np.zeros((N_CLASSES, N_CLASSES), np.int64)
    for start in range(0, len(crops), batch):
        x = crops.depth[start : start + batch, None].astype(np.float32) / np.float32(65535)
        predicted = model(torch.from_numpy(x).contiguous(memory_format=torch.channels_last)).argmax(1)
        total += confusion_matrix(crops.parts[start : start + batch], predicted.numpy().astype(np.uint8))
    return total


def export_onnx(model: nn.Module, path: Path) -> None:
    """Write the network as ONNX: ``depth`` (B, 1, 212, 212) -> ``probability`` (B, 12, 212, 212)."""
    example = torch.rand(1, 1, 212, 212)
    whole = nn.Sequential(model, nn.Softmax(dim=1)).eval()
    with replacing(path) as temporary, warnings.catch_warnings():
        # The newer exporter needs another package, onnxscript, and gains nothing here.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            whole,
            (example,),
            temporary,
            input_names=["depth"],
            output_names=["probability"],
            dynamic_axes={"depth": {0: "batch"}, "probability": {0: "batch"}},
            dynamo=False,
        )


def _claim(out: Path, schedule: Schedule, crops: Crops) -> None:
    """Start or resume: schedule and data say whose half-finished training this is."""
    data = {"images": len(crops), "crc32": crc32(crops.parts.tobytes(), crc32(crops.depth.tobytes()))}
    order = (json.dumps({**asdict(schedule), "data": data}, sort_keys=True) + "\n").encode()
    if (out / "schedule.json").is_file():
        if (out / "schedule.json").read_bytes() != order:
            raise ExistsError(
                f"{out} holds another training (schedule or data differ); take another folder or --overwrite"
            )
        return
    if out.exists() and any(out.iterdir()):
        raise ExistsError(f"{out} exists and is no training; choose another folder or pass --overwrite")
    out.mkdir(parents=True, exist_ok=True)
    write_bytes(out / "schedule.json", order)


def _save(out: Path, model: nn.Module, optimizer: torch.optim.Optimizer, history: list[Epoch]) -> None:
    tensors = {f"model.{k}": v.contiguous() for k, v in model.state_dict().items()}
    state = optimizer.state_dict()
    for index, entry in state["state"].items():
        tensors |= {f"optimizer.{index}.{k}": v.contiguous() for k, v in entry.items()}
    meta = {"history": json.dumps([asdict(e) for e in history])}
    with replacing(out / "checkpoint.safetensors") as temporary:
        save_file(tensors, temporary, meta)


def _resume(out: Path, model: nn.Module, optimizer: torch.optim.Optimizer) -> list[Epoch]:
    path = out / "checkpoint.safetensors"
    if not path.is_file():
        return []
    try:
        tensors = load_file(path)
        with path.open("rb") as file:
            header = json.loads(file.read(int.from_bytes(file.read(8), "little")))["__metadata__"]
        model.load_state_dict({k[6:]: v for k, v in tensors.items() if k.startswith("model.")})
        state = optimizer.state_dict()
        state["state"] = _optimizer_state(tensors)
        optimizer.load_state_dict(state)
        return [Epoch(**e) for e in json.loads(header["history"])]
    except (OSError, ValueError, KeyError, RuntimeError, TypeError, SafetensorError) as error:
        raise FormatError(
            f"checkpoint {path} cannot be resumed ({error}); remove it or start elsewhere"
        ) from error


def _optimizer_state(tensors: dict[str, Tensor]) -> dict[int, dict[str, Tensor]]:
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith("optimizer."):
            _, index, key = name.split(".", 2)
            state.setdefault(int(index), {})[key] = value
    return state
