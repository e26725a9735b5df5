"""The verb that labels frames by a network."""

import time
from pathlib import Path
from typing import Annotated

import typer

from annotate import store
from annotate.store import LabelSet
from cli.console import Json, Overwrite, clear, finish_run, progress, say
from cli.labelling import Labels, Window
from eval.predict import SHIPPED_WEIGHTS, Network, predict_labels, predict_source
from sensors.importers import open_source


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
