"""Train the suit network: python -m tools.fit.suit_network FOLDER [--recordings 160] [--workers 2].

``--start`` trains given weights further, at a lower rate, ``--first`` chooses the recordings. FOLDER gets
examples of the virtual rig, ``examples/NUMBER.npz``, checkpoints, and ``reader.onnx``, for
eval/weights/full/, from which tools.fit.quantise makes the quantised one. The same command resumes an
interrupted run. Constants are untuned.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch

from annotate.labelset.cast_note import check_trainable
from annotate.labelset.claim import Claim, login
from annotate.labelset.dataset import sha256
from annotate.labelset.labelled_frames import open_frames
from eval.training.segmentation.augmentation import Sampling
from eval.training.segmentation.examples import Example, ExampleFiles, store_examples
from eval.training.segmentation.network import SuitNet, load_suit_network
from eval.training.segmentation.scenes import rig_examples, training_rig
from eval.training.segmentation.train import (
    EXAMPLES,
    WEIGHTS,
    Stage,
    SuitTraining,
    Watch,
    claim,
    train_stages,
)
from eval.training.segmentation.validation import Validation
from sensors.errors import CloudError
from synth.images.workers import processes

STAGES = (  # first the whole person, at half the time a step; then borders, at labelling's resolution
    Stage(Sampling(0.022, 112), 9_000, 1.5e-3, 0.998),
    Stage(Sampling(0.012, 160), 4_500, 1e-3, 0.998),
)
CONTINUED = (Stage(Sampling(0.012, 160), 2_000, 5e-4, 0.998, precision="bfloat16"),)  # from trained weights
EVERY, SEED = 12, 0  # of twelve files the last is held out, with bodies of its own
LINE_STEPS = 20  # steps between two lines
Maker = Callable[[], Iterator[Example | None]]


def main() -> None:
    """Make examples, train, write the network."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--recordings", type=int, default=160, help="of 32 frames")
    parser.add_argument("--first", type=int, default=0, help="number of the first recording")
    parser.add_argument("--start", type=Path, help="full-precision weights to train further (random ones)")
    parser.add_argument("--seed", type=int, default=SEED, help="of the samples and the first weights (0)")
    parser.add_argument("--workers", type=int, default=2, help="processes that make examples")
    given = parser.parse_args()
    one_thread()
    stages = CONTINUED if given.start else STAGES
    plan = {"seed": given.seed, "first": given.first, "recordings": given.recordings}
    start = sha256(given.start) if given.start else None
    claim(given.folder, {**plan, "start": start, "stages": [asdict(stage) for stage in stages]})
    with Claim.take(given.folder, login()):
        numbers = range(given.first, given.first + given.recordings)
        files = {number: given.folder / EXAMPLES / f"{number:04d}.npz" for number in numbers}
        make_files({path: partial(_examples, n, is_held_out(n)) for n, path in files.items()}, given.workers)
        torch.manual_seed(given.seed)
        network = load_suit_network(given.start) if given.start else SuitNet()
        settings = [(stage, given.seed + number) for number, stage in enumerate(stages)]
        found = _trained(network, settings, files, given.folder)
    print(f"{given.folder / WEIGHTS}: {found}")


def _trained(
    network: SuitNet, stages: Sequence[tuple[Stage, int]], files: Mapping[int, Path], folder: Path
) -> Validation:
    """Train a network in stages, each with its seed, on the recordings of ``files``, by number; return its
    validation.
    """
    learnt, held_out = (
        ExampleFiles([path for number, path in files.items() if is_held_out(number) == held])
        for held in (False, True)
    )
    trainings = [SuitTraining(learnt, *stage_and_seed) for stage_and_seed in stages]
    return train_stages(network, trainings, held_out, folder, lines(LINE_STEPS))


def _examples(number: int, held_out: bool) -> Iterator[Example]:
    return rig_examples(training_rig(number, held_out))


def one_thread() -> None:
    """Limit this process to one thread, because the result depends on the number of threads."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)


def make_files(makers: Mapping[Path, Maker], workers: int) -> None:
    """Write the missing files of examples, each by its maker, and print their names."""
    missing = [(maker, path) for path, maker in makers.items() if not path.exists()]
    with processes(workers) as pool:
        for path in pool.executor.map(_store, *zip(*missing, strict=True)) if missing else ():
            print(path, flush=True)


def _store(maker: Maker, path: Path) -> Path:
    store_examples((example for example in maker() if example is not None), path)
    return path


def is_held_out(number: int) -> bool:
    """Return whether file ``number`` is held out: it shows the bodies of ``shared_bodies.HELD_OUT`` alone."""
    return number % EVERY == EVERY - 1


def split_files(files: list[Path]) -> tuple[list[Path], list[Path]]:
    """Return the files to train on, and those held out."""
    held_out = [file for number, file in enumerate(files) if is_held_out(number)]
    return [file for file in files if file not in held_out], held_out


def check_inputs(paths: list[Path]) -> None:
    """End the process with status 1 and one line for a path of the judging cast, or of other files."""
    try:
        for path in paths:
            check_trainable(path, open_frames(path).info)
    except CloudError as error:
        sys.exit(str(error))


def lines(every: int) -> Watch:
    """Return a function that prints the mean loss of ``every`` steps."""
    losses: list[float] = []

    def watch(step: int, loss: float) -> None:
        losses.append(loss)
        if step % every == 0:
            print(f"step {step}: loss {np.mean(losses):.4f}", flush=True)
            losses.clear()

    return watch


if __name__ == "__main__":
    main()
