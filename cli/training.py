"""The verb that trains a network."""

import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from cli.console import Json, Overwrite, clear, finish, progress, say
from sensors.errors import CloudError


def train(
    data: Annotated[list[Path], typer.Argument(help="Datasets and label sets.")],
    out: Annotated[
        Path, typer.Option(help="Folder for checkpoints and weights; a broken run goes on there.")
    ],
    held_out: Annotated[
        Path | None, typer.Option(help="Dataset or label set to measure on each epoch.")
    ] = None,
    epochs: Annotated[int, typer.Option(min=1, max=10_000)] = 6,
    batch: Annotated[int, typer.Option(min=1, max=1024)] = 16,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Train the compact network; writes weights.onnx. Needs the extra 'train'."""
    try:
        from eval.train import Epoch, Schedule, export_onnx
        from eval.train import train as run
    except ImportError as error:
        raise CloudError(f"training needs torch ({error.name} is missing): pip install '.[train]'") from error
    from eval.data import load_crops

    started = time.monotonic()
    crops = load_crops(data)
    measured = load_crops([held_out]) if held_out else crops.first(512)
    clear(out, "schedule.json", overwrite, *data, *([held_out] if held_out else []))
    with progress("train, epochs", epochs) as advance:

        def told(epoch: Epoch) -> None:
            advance(1)
            scores = f"loss {epoch.loss:.4f}, mean recall {epoch.mean_recall:.4f}, mIoU {epoch.miou:.4f}"
            say(f"epoch {epoch.number + 1}: {scores}")

        schedule = Schedule(epochs=epochs, batch=batch, seed=seed)
        model, history = run(crops, measured, out, schedule, told)
    export_onnx(model, out / "weights.onnx")
    seconds = time.monotonic() - started
    result = {
        "epochs": len(history),
        "loss": history[-1].loss,
        "seconds": round(seconds, 1),
        "weights": str(out / "weights.onnx"),
        "history": [asdict(e) for e in history],
    }
    finish(
        result, json, f"{len(history)} epochs, loss {history[-1].loss:.4f}, weights in {out / 'weights.onnx'}"
    )
