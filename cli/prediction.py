"""The verb ``predict``: label frames with a network."""

import time
from functools import partial
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from annotate.labelset import store
from annotate.labelset.frames import LabelledFrames, holds_frames, open_frames
from cli.console import Json, Overwrite, clear, finish_run, progress, say
from cli.labelling import Labels, Window
from eval.network.onnx_network import SHIPPED_WEIGHTS, OnnxNetwork
from eval.network.predict import predict_frames, predict_source
from sensors.importers.open_source import open_source
from sensors.rig.frame import FrameSource


def predict(
    source: Annotated[Path, Argument(help="Session, label set, dataset, or what import reads.")],
    out: Labels,
    weights: Annotated[
        Path, Option(help="Network (.onnx).", show_default="the shipped one")
    ] = SHIPPED_WEIGHTS,
    window: Window = None,
    probabilities: Annotated[
        bool, Option("--probabilities", help="Also store the probabilities of all classes, 12 kB per frame.")
    ] = False,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Label depth images with a network; label sets and datasets keep their outlines of the person."""
    network = OnnxNetwork(weights)
    frames: LabelledFrames | FrameSource
    if holds_frames(source):
        frames = open_frames(source)
        work = partial(predict_frames, frames, network, out, probabilities=probabilities)
    else:
        frames = open_source(source)
        for note in frames.notes:
            say(note)
        work = partial(predict_source, frames, network, out, window_c=window, probabilities=probabilities)
    clear(out, store.MANIFEST, overwrite, source, weights)
    started, total = time.monotonic(), len(frames)
    with progress("predict", total) as advance:
        run = work(progress=advance)
    ms = 1000 * (time.monotonic() - started) / max(1, total)
    result = {"frames": len(run.labels), "ms_per_frame": round(ms, 2)}
    finish_run(result, run, json, f"{len(run.labels)} frames in {out}, {ms:.0f} ms each")
