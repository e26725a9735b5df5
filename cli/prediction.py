"""The verb ``predict``: label frames with a network."""

import time
from pathlib import Path
from typing import Annotated

import typer

from annotate.labelset import dataset, store
from annotate.labelset.dataset import Dataset
from annotate.labelset.store import LabelSet
from cli.console import Json, Overwrite, clear, finish_run, progress, say
from cli.labelling import Labels, Window
from eval.network.onnx_network import SHIPPED_WEIGHTS, Network
from eval.network.predict import predict_frames, predict_source
from eval.scores.frames import open_frames
from sensors.importers.open_source import open_source


def predict(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SRC", help="Session, label set, dataset, or anything else that import reads."
        ),
    ],
    out: Labels,
    weights: Annotated[
        Path, typer.Option(help="Network (.onnx).", show_default="the shipped one")
    ] = SHIPPED_WEIGHTS,
    window: Window = None,
    probabilities: Annotated[
        bool,
        typer.Option("--probabilities", help="Also store the probabilities of all classes, 12 kB per frame."),
    ] = False,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Label depth images with a network; label sets and datasets keep their outlines of the person."""
    network = Network(weights)
    outlined = any((source / manifest).is_file() for manifest in (store.MANIFEST, dataset.MANIFEST))
    frames = open_frames(source) if outlined else open_source(source)
    for note in () if isinstance(frames, LabelSet | Dataset) else frames.notes:
        say(note)
    clear(out, store.MANIFEST, overwrite, source, weights)
    started, total = time.monotonic(), len(frames)
    with progress("predict", total) as advance:
        if isinstance(frames, LabelSet | Dataset):
            run = predict_frames(frames, network, out, advance, probabilities=probabilities)
        else:
            run = predict_source(frames, network, out, advance, window, probabilities=probabilities)
    ms = 1000 * (time.monotonic() - started) / max(1, total)
    result = {"frames": len(run.labels), "ms_per_frame": round(ms, 2)}
    finish_run(result, run, json, f"{len(run.labels)} frames in {out}, {ms:.0f} ms each")
