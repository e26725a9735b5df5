"""Trains the person finder: python -m tools.train_finder FOLDER OUT.onnx [--seeds 400] [--minutes 45].

FOLDER keeps the scenes, rendered where they are not there yet: a second run begins with the training.
"""

import argparse
from pathlib import Path

import torch

from eval.training.finder_images import load_scenes, store_scenes
from eval.training.finder_net import export_finder, train_finder


def main() -> None:
    """Render scenes, train, write the network."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seeds", type=int, default=400, help="each makes 4 frames of the rig and 8 rooms")
    parser.add_argument("--minutes", type=float, default=45, help="of training")
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    given.folder.mkdir(parents=True, exist_ok=True)
    for seed in range(1, given.seeds + 1):
        store_scenes(given.folder, seed)

    def progress(step: int, loss: float) -> None:
        if step % 50 == 0:
            print(f"step {step}: loss {loss:.3f}", flush=True)

    export_finder(train_finder(load_scenes(given.folder), given.minutes, 0, progress), given.out)


if __name__ == "__main__":
    main()
