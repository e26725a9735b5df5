"""Trains the person finder: python -m tools.fit.finder FOLDER OUT.onnx [--seeds 120] [--minutes 60].

FOLDER keeps the scenes, rendered where they are not there yet, and OUT.pt the state of the training: a second
run goes on with both.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
import torch

from eval.training.finder.images import load_scenes, store_scenes
from eval.training.finder.network import export_finder, train_finder


def main() -> None:
    """Render scenes, train, write the network."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seeds", type=int, default=120, help="each makes 32 frames of the rig and 8 rooms")
    parser.add_argument(
        "--minutes", type=float, default=60, help="of training, those of earlier runs included"
    )
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    cv2.setNumThreads(given.threads)
    given.folder.mkdir(parents=True, exist_ok=True)
    for seed in range(1, given.seeds + 1):
        store_scenes(given.folder, seed)
    losses: list[float] = []

    def progress(step: int, loss: float) -> None:
        losses.append(loss)
        if step % 50 == 0:
            print(f"step {step}: loss {np.mean(losses):.4f}", flush=True)
            losses.clear()

    stock, checkpoint = load_scenes(given.folder), given.out.with_suffix(".pt")
    export_finder(train_finder(stock, given.minutes, checkpoint, progress), given.out)


if __name__ == "__main__":
    main()
