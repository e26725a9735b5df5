"""Train the suit network: python -m tools.fit.suit_network FOLDER [--recordings 160] [--workers 2].

FOLDER gets the examples of each recording of the virtual rig, ``examples/NUMBER.npz``, the states of the
training, and ``reader.onnx``, for eval/weights/full/, from where tools.fit.quantise takes it. Where it was
broken off, the same command goes on.
"""

import argparse
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import torch

from annotate.labelset.claim import Claim, login
from eval.training.segmentation.examples import Stock, store_examples
from eval.training.segmentation.fit import EXAMPLES, WEIGHTS, claim, fit
from eval.training.segmentation.network import ReaderNet
from eval.training.segmentation.scenes import rig_examples, training_rig
from eval.training.segmentation.train import Stage, Watch
from synth.images.workers import processes

STAGES = (Stage(0.022, 112, 9_000, 1.5e-3, 0.998), Stage(0.012, 160, 4_500, 1e-3, 0.998))
"""First what a whole person is, in half the time a step, then borders as labelling sees them. Chosen by
eye."""
HELD_OUT, SEED = 12, 0
"""Of each twelve recordings the last is not trained on; of what is drawn."""
LINE_STEPS = 20
"""Steps between two lines."""


def main() -> None:
    """Make examples, train, write the network."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--recordings", type=int, default=160, help="of 32 frames")
    parser.add_argument("--workers", type=int, default=2, help="processes that make examples")
    given = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    stages = [asdict(stage) for stage in STAGES]
    claim(given.folder, {"seed": SEED, "recordings": given.recordings, "stages": stages})
    with Claim.take(given.folder, login()):
        files = [given.folder / EXAMPLES / f"{number:04d}.npz" for number in range(given.recordings)]
        if missing := [file for file in files if not file.exists()]:
            with processes(given.workers) as pool:
                for line in pool.executor.map(_store, missing):
                    print(line, flush=True)
        held_out = files[HELD_OUT - 1 :: HELD_OUT]
        learnt = [file for file in files if file not in held_out]
        torch.manual_seed(SEED)
        found = fit(ReaderNet(), Stock(learnt), Stock(held_out), STAGES, given.folder, SEED, lines())
    print(f"{given.folder / WEIGHTS}: {found}")


def _store(path: Path) -> str:
    """Make a recording's examples, by the number in the file's name."""
    rig = training_rig(int(path.stem))
    store_examples(rig_examples(rig), path)
    return f"{path}: {rig.name}, {rig.suit.name}"


def lines() -> Watch:
    """What prints the mean loss of some steps."""
    losses: list[float] = []

    def watch(step: int, loss: float) -> None:
        losses.append(loss)
        if step % LINE_STEPS == 0:
            print(f"step {step}: loss {np.mean(losses):.4f}", flush=True)
            losses.clear()

    return watch


if __name__ == "__main__":
    main()
