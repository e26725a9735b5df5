"""Weights of the labelling engine, fitted to another suit or rig: clothed mask, second look, confidence.

Each step works on what those before it make of a frame, so the order matters. Confidence is fitted to
recordings that the network has not been trained on, since it would come out too high on others. It is itself
one of the network's descriptors: by the shipped weights in training, by the new ones afterwards.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch

from annotate.engine import Engine, Steps, Weights, shipped_weights
from annotate.person.extract import Survey
from eval.training.engine_data import Observed, Recording, Rows, load_rows, observed, rows_of, save_rows
from eval.training.engine_graph import EPOCHS, Figures, trained
from eval.training.engine_odds import fit_clothed, fit_confidence, judged, known_patches
from sensors.errors import CloudError, ExistsError
from sensors.files.atomic import write_bytes

PLAN, ROWS, WEIGHTS = "plan.json", "rows", "weights.npz"
"""Files in the folder: what is trained on, rows of each recording, and the result."""
HELD_OUT = 4
"""Of each four recordings, counted from the last, the last is not trained on; chosen by eye."""
PATCH_FRAMES = 200
"""Frames that the clothed mask is fitted to, at most; the shipped one was fitted to 196."""

Progress = Callable[[str, int], AbstractContextManager[Callable[[int], None]]]
"""Shows a stage by name and number of steps; yields what is called with the steps done."""


class Trained(NamedTuple):
    """Weights as written to ``path``; figures of the network on the frames held out, at the end."""

    path: Path
    weights: Weights
    frames: int
    frames_held_out: int
    figures: Figures


def train_labels(recordings: Sequence[Recording], out: Path, seed: int, progress: Progress) -> Trained:
    """Fit all weights to recordings with known labels; writes ``out``/weights.npz.

    A run that was broken off goes on with the recordings that it has read. The same recordings and seed give
    the same weights. Raises CloudError for fewer than two recordings, ExistsError where ``out`` holds another
    training or a finished one.
    """
    if len(recordings) < 2:
        raise CloudError("one recording is too few: confidence is fitted to another; give two or more")
    torch.set_num_threads(1)
    _claim(out, recordings, seed)
    held_out = recordings[::-HELD_OUT][::-1]
    learnt = [one for one in recordings if one not in held_out]
    weights = _clothed(learnt, shipped_weights(), progress)
    files = {one: out / ROWS / f"{i}.npz" for i, one in enumerate(recordings)}
    train, test = (
        [frame for one in some for frame in _rows(one, files[one], weights, progress)]
        for some in (learnt, held_out)
    )
    with progress("second look, epochs", EPOCHS) as advance:
        network, figures = trained(train, test, seed, advance)
    weights = replace(weights, network=network)
    looked = [judged(frame) for frame in _read(held_out, Engine(weights=weights), "confidence", progress)]
    weights = replace(weights, confidence=fit_confidence(looked))
    weights.save(out / WEIGHTS)
    return Trained(out / WEIGHTS, weights, len(train), len(test), figures)


def _claim(out: Path, recordings: Sequence[Recording], seed: int) -> None:
    """Take a folder for this very training."""
    digests = [[one.source.name, one.digest()] for one in recordings]
    plan = {"seed": seed, "start": shipped_weights().sha256(), "recordings": digests}
    text = json.dumps(plan, indent=1).encode()
    if (out / WEIGHTS).exists() or ((out / PLAN).exists() and (out / PLAN).read_bytes() != text):
        raise ExistsError(f"{out} holds another training; choose another folder or pass --overwrite")
    (out / ROWS).mkdir(parents=True, exist_ok=True)
    write_bytes(out / PLAN, text)


def _clothed(recordings: Sequence[Recording], start: Weights, progress: Progress) -> Weights:
    """The weights with those of the clothed mask fitted to some of the frames whose labels count."""
    total = sum(len(one.frame_ids) for one in recordings)
    every, seen = -(-total // PATCH_FRAMES), []
    with progress("clothed mask, frames", total) as advance:
        for recording in recordings:
            known = ((cloud, truth) for cloud, truth in recording.clouds() if truth is not None)
            for number, (cloud, truth) in enumerate(known):
                if number % every == 0:
                    survey = Survey(cloud, None, recording.suit, Engine(weights=start))
                    if (candidates := survey.person(None).candidates) is not None:
                        seen.append(known_patches(candidates.clues, truth))
                advance(1)
    if not seen:
        raise CloudError("nobody in a suit is found in these recordings; check the palette, or record more")
    clothed, touch = fit_clothed(seen)
    return replace(start, clothed=clothed, touch=touch)


def _rows(recording: Recording, path: Path, weights: Weights, progress: Progress) -> list[Rows]:
    """Rows of a recording's frames, from the file of an earlier run where there is one."""
    if not path.exists():
        engine = Engine(Steps(second_look=False), weights)
        frames = _read([recording], engine, recording.source.name, progress)
        save_rows([rows_of(frame) for frame in frames], path)
    return load_rows(path)


def _read(
    recordings: Sequence[Recording], engine: Engine, what: str, progress: Progress
) -> Iterator[Observed]:
    """Frames of recordings as an engine reads them, the usable ones."""
    with progress(f"{what}, frames", sum(len(one.source) for one in recordings)) as advance:
        for recording in recordings:
            for frame in observed(recording, engine):
                if frame is not None:
                    yield frame
                advance(1)
