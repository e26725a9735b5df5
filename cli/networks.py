"""Verbs on networks: train, predict, evaluate, report."""

import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from annotate import store
from annotate.store import LabelSet
from cli.console import Json, Overwrite, clear, finish, finish_run, progress, say
from cli.labelling import Labels, Window
from eval.compare import compare_sets
from eval.predict import SHIPPED_WEIGHTS, Network, predict_labels, predict_source
from eval.report.build import write_report
from eval.results import Result, load_result, save_result
from sensors.errors import CloudError
from sensors.importers import open_source


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


def predict(
    source: Annotated[
        Path, typer.Argument(metavar="SRC", help="Session, folder of depth PNGs, PCD, PLY or label set.")
    ],
    out: Labels,
    weights: Annotated[
        Path, typer.Option(help="Network (.onnx).", show_default="the shipped one")
    ] = SHIPPED_WEIGHTS,
    window: Window = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Label by a network trained on synthetic depth; in a label set only within its persons' outlines."""
    network = Network(weights)
    if (source / store.MANIFEST).is_file():
        labels = LabelSet.open(source)
        clear(out, store.MANIFEST, overwrite, source, weights)
        started, total = time.monotonic(), len(labels)
        with progress("predict", total) as advance:
            run = predict_labels(labels, network, out, advance)
    else:
        frames = open_source(source)
        for note in frames.notes:
            say(note)
        clear(out, store.MANIFEST, overwrite, source, weights)
        started, total = time.monotonic(), len(frames)
        with progress("predict", total) as advance:
            run = predict_source(frames, network, out, advance, window)
    ms = 1000 * (time.monotonic() - started) / max(1, total)
    result = {"frames": len(run.labels), "ms_per_frame": round(ms, 2)}
    finish_run(result, run, json, f"{len(run.labels)} frames in {out}, {ms:.0f} ms each")


def evaluate(
    predicted: Annotated[Path, typer.Argument(metavar="PREDICTED", help="Label set.")],
    truth: Annotated[Path, typer.Argument(metavar="TRUTH", help="Label set.")],
    out: Annotated[Path | None, typer.Option(help="Keep the result here for 'report' (JSON).")] = None,
    title: Annotated[str, typer.Option(help="Name of the result in the report.")] = "Network",
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Measure a label set against the truth, with confidence intervals and the confusion matrix."""
    comparison = compare_sets(LabelSet.open(predicted), LabelSet.open(truth))
    if out is not None:
        facts = {"predicted": str(predicted), "truth": str(truth)}
        out.parent.mkdir(parents=True, exist_ok=True)
        save_result(out, Result(title, comparison, facts), overwrite)
    result = comparison.to_evaluation_json()
    shown = {k: result[k] for k in ("frames", "mean_recall", "miou", "person_iou", "left_right_swap_rate")}
    finish(result, json, "\n".join(f"{key}: {value}" for key, value in shown.items()))


def report(
    results: Annotated[list[Path], typer.Argument(help="Results that 'evaluate --out' kept.")],
    out: Annotated[Path, typer.Option("--file", "--out", help="HTML file to write.")],
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Put results side by side, with the paper's, on one page that opens offline."""
    from eval.report.gallery import make_gallery

    loaded = [load_result(path) for path in results]
    galleries = {}
    for result in loaded:
        sets = [Path(result.facts.get(k, "")) for k in ("predicted", "truth")]
        if all((path / store.MANIFEST).is_file() for path in sets):
            predicted, truth = (LabelSet.open(path) for path in sets)
            galleries[result.title] = make_gallery(result.comparison, predicted, truth)
    write_report(out, loaded, galleries, overwrite=overwrite)
    finish({"path": str(out)}, json, str(out))
