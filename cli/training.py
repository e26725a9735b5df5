"""The verb that trains a network."""

import time
from dataclasses import asdict, fields
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.console import Json, Overwrite, clear, finish, progress, say
from eval.augment import Augmentation
from eval.data import Crops, load_crops
from sensors.errors import CloudError

if TYPE_CHECKING:
    from torch import nn

    from eval.checkpoint import Epoch
    from eval.plan import Plan, Recipe

Without = StrEnum("Without", [field.name for field in fields(Augmentation)])  # type: ignore[misc]
"""Each way of making training images harder."""


class NetworkName(StrEnum):
    """What can be trained."""

    COMPACT = "compact"


class RecipeName(StrEnum):
    """How it is trained."""

    MODERN = "modern"
    PAPER = "paper"


class PrecisionName(StrEnum):
    """Numbers of the forward pass."""

    FLOAT32 = "float32"
    BFLOAT16 = "bfloat16"


def train(
    data: Annotated[list[Path], typer.Argument(help="Datasets and label sets.")],
    out: Annotated[
        Path, typer.Option(help="Folder for checkpoints and weights; a broken run goes on there.")
    ],
    test: Annotated[
        list[Path] | None, typer.Option(help="Dataset or label set to measure on each epoch; repeatable.")
    ] = None,
    test_images: Annotated[int, typer.Option(min=1, help="Images of these, evenly spread.")] = 512,
    hold_out: Annotated[
        list[str] | None, typer.Option(help="Subject to measure on, not to train on; repeatable.")
    ] = None,
    network: Annotated[NetworkName, typer.Option(help="Architecture.")] = NetworkName.COMPACT,
    recipe: Annotated[
        RecipeName, typer.Option(help="AdamW with one cycle, or the paper's SGD and summed loss.")
    ] = RecipeName.MODERN,
    init: Annotated[
        Path | None, typer.Option(help="weights.safetensors to start from; it names the network.")
    ] = None,
    without: Annotated[
        list[Without] | None, typer.Option(help="Augmentation to leave out; repeatable.")
    ] = None,
    epochs: Annotated[int, typer.Option(min=1, max=10_000)] = 12,
    batch: Annotated[int | None, typer.Option(min=1, max=1024, show_default="16, the paper's 12")] = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    precision: Annotated[
        PrecisionName, typer.Option(help="bfloat16 is faster where the processor computes in it.")
    ] = PrecisionName.FLOAT32,
    workers: Annotated[int, typer.Option(min=0, max=64, help="Processes that make images ahead.")] = 0,
    checkpoint_minutes: Annotated[float, typer.Option(min=0)] = 5.0,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Train a network; writes weights.onnx, weights.safetensors, history.json. Needs the extra 'train'."""
    started, tests = time.monotonic(), test or []
    try:
        from eval.train import Watch, images_left
    except ImportError as error:
        raise CloudError(f"training needs torch ({error.name} is missing): pip install '.[train]'") from error
    clear(out, "plan.json", overwrite, *data, *tests, *([init] if init else []))
    plan, model = _plan(network, recipe, init, without or [], epochs, batch, seed, precision)
    crops = load_crops(data, without=frozenset(hold_out or []))
    measured = _measured(data, tests, hold_out or [], test_images)
    with progress("train, images", images_left(out, plan, crops)) as advance:
        watch = Watch(advance, lambda epoch: _tell(epoch, epochs), 60 * checkpoint_minutes)
        history = _trained(crops, measured, out, plan, watch, model, workers)
    result = {
        "epochs": len(history),
        "loss": history[-1].loss,
        "seconds": round(time.monotonic() - started, 1),
        "weights": str(out / "weights.onnx"),
        "history": [asdict(epoch) for epoch in history],
    }
    text = f"{len(history)} epochs, loss {history[-1].loss:.4f}, weights in {out / 'weights.onnx'}"
    finish(result, json, text)


def _plan(
    network: NetworkName,
    recipe: RecipeName,
    init: Path | None,
    without: list[Without],
    epochs: int,
    batch: int | None,
    seed: int,
    precision: PrecisionName,
) -> "tuple[Plan, nn.Module | None]":
    from eval.checkpoint import load_weights
    from eval.compact import CompactConfig
    from eval.plan import ModernRecipe, PaperRecipe, Plan

    model, config = load_weights(init) if init else (None, CompactConfig())
    how = Augmentation(**{f.name: f.name not in without for f in fields(Augmentation)})
    chosen: Recipe
    match recipe:
        case RecipeName.MODERN:
            chosen = ModernRecipe() if batch is None else ModernRecipe(batch)
        case RecipeName.PAPER:
            chosen = PaperRecipe() if batch is None else PaperRecipe(batch)
    return Plan(config, chosen, how, epochs, seed, precision.value), model


def _measured(data: list[Path], tests: list[Path], hold_out: list[str], images: int) -> Crops | None:
    if tests and hold_out:
        raise CloudError("--test and --hold-out both say what to measure on; give one of them")
    if hold_out:
        return load_crops(data, only=frozenset(hold_out)).spread(images)
    return load_crops(tests).spread(images) if tests else None


def _trained(crops, measured, out, plan, watch, model, workers):
    from eval.checkpoint import save_weights
    from eval.export import export_onnx
    from eval.train import train as run

    model, done = run(crops, measured, out, plan, watch, model, workers)
    save_weights(out / "weights.safetensors", model, plan.network)
    export_onnx(model, out / "weights.onnx")
    return done.epochs


def _tell(epoch: "Epoch", epochs: int) -> None:
    scores = "" if epoch.miou is None else f", mean recall {epoch.mean_recall:.4f}, mIoU {epoch.miou:.4f}"
    say(f"epoch {epoch.number} of {epochs}: loss {epoch.loss:.4f}{scores}")
