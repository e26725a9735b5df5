"""A reader fitted to recordings whose parts are known, or to any examples."""

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import torch

from annotate.labelset.claim import Claim, login
from annotate.labelset.dataset import sha256
from annotate.segmentation.segment import SAMPLE_M
from eval.training.segmentation.examples import Example, Recording, Stock, store_examples
from eval.training.segmentation.network import FULL_READER, ReaderNet, export_reader, load_reader
from eval.training.segmentation.train import Stage, Watch, trained
from eval.training.segmentation.validation import Outcome, outcome
from sensors.errors import CloudError, ExistsError
from sensors.files.atomic import write_bytes

PLAN, EXAMPLES, WEIGHTS = "plan.json", "examples", "reader.onnx"
"""Files in the folder: what is trained on and how, each recording's examples, and the result."""
HELD_OUT = 4
"""Of each four recordings, counted from the last, the last is not trained on. Chosen by eye."""
SIDE = 160
"""Samples along the side of a drawn image, 1.9 m: most of a person. Chosen by eye."""
PEAK_RATE, AVERAGED = 3e-4, 0.99
"""Highest learning rate and decay of the average where a trained network goes on, low, so that it keeps what
it knows. Chosen by eye."""

Progress = Callable[[str, int], AbstractContextManager[Callable[[int], None]]]
"""Shows a stage by name and number of steps; yields what is called with the steps done."""


class Fitted(NamedTuple):
    """Weights as written to ``path``; what the network made of the frames held out before, and makes now."""

    path: Path
    frames: int
    frames_held_out: int
    before: Outcome
    after: Outcome


def train_labels(
    recordings: Sequence[Recording], out: Path, steps: int, seed: int, progress: Progress
) -> Fitted:
    """Train the shipped reader on with recordings whose labels are known; writes ``out``/reader.onnx.

    A run that was broken off goes on with what it has read and trained. The same recordings, steps and seed
    give the same weights. Examples, 3 MB a frame, are removed in the end. Raises CloudError for fewer than
    two recordings or where no frame can be learnt from or held out, ExistsError where ``out`` holds another
    training or a finished one, ClaimedError while another process works there.
    """
    if len(recordings) < 2:
        raise CloudError("one recording is too few: confidence is fitted to another; give two or more")
    torch.set_num_threads(1)
    stage = Stage(SAMPLE_M, SIDE, steps, PEAK_RATE, AVERAGED)
    given = {
        "start": sha256(FULL_READER),
        "recordings": [[r.source.name, r.digest()] for r in recordings],
    }
    claim(out, {"seed": seed, "stages": [asdict(stage)], **given})
    with Claim.take(out, login()):
        files = [_stored(one, out / EXAMPLES / f"{i}.npz", progress) for i, one in enumerate(recordings)]
        test = files[::-HELD_OUT]
        learnt, held_out = Stock([file for file in files if file not in test]), Stock(test)
        network = load_reader(FULL_READER)
        before = outcome(network, held_out, SAMPLE_M)
        with progress("train, steps", steps) as advance:
            after = fit(network, learnt, held_out, [stage], out, seed, shown(advance))
    shutil.rmtree(out / EXAMPLES)
    return Fitted(out / WEIGHTS, len(learnt), len(held_out), before, after)


def claim(out: Path, plan: dict[str, Any]) -> None:
    """Take a folder for this very training. Raises ExistsError where it holds another, or a finished one."""
    text = json.dumps(plan, indent=1).encode()
    if (out / WEIGHTS).exists() or ((out / PLAN).exists() and (out / PLAN).read_bytes() != text):
        raise ExistsError(f"{out} holds another training; choose another folder or pass --overwrite")
    (out / EXAMPLES).mkdir(parents=True, exist_ok=True)
    write_bytes(out / PLAN, text)


def shown(advance: Callable[[int], None]) -> Watch:
    """What shows the steps, from the first that is left on."""
    last = 0

    def watch(step: int, loss: float) -> None:
        nonlocal last
        advance(step - last)
        last = step

    return watch


def _stored(recording: Recording, path: Path, progress: Progress) -> Path:
    """The file of a recording's examples, made now unless an earlier run has."""
    if not path.exists():
        with progress(f"{recording.source.name}, frames", len(recording.source)) as advance:

            def seen() -> Iterator[Example]:
                for example in recording.examples():
                    advance(1)
                    if example is not None:
                        yield example

            store_examples(seen(), path)
    return path


def fit(
    start: ReaderNet,
    learnt: Stock,
    held_out: Stock,
    stages: Sequence[Stage],
    out: Path,
    seed: int,
    watch: Watch = lambda step, loss: None,
) -> Outcome:
    """Train ``start`` in stages and write ``out``/reader.onnx, its confidence fitted to what is held out.

    A run that was broken off goes on from the checkpoints in ``out``. Raises FormatError where one of them is
    damaged.
    """
    network = start
    for number, stage in enumerate(stages):
        network = trained(network, learnt, stage, out / f"stage-{number}.safetensors", seed + number, watch)
    found = outcome(network, held_out, stages[-1].sample_m)
    export_reader(network, out / WEIGHTS, found.temperature)
    return found
