"""Train the person finder: python -m tools.fit.finder FOLDER OUT.onnx [--seeds 120] [--minutes 60].

FOLDER keeps the rendered scenes, and OUT.safetensors the checkpoint: the same command resumes an interrupted
run.
"""

import argparse
from pathlib import Path

import cv2
import torch

from eval.training.finder.images import load_scenes, store_scenes
from eval.training.finder.network import FinderTraining, export_finder, train_finder
from tools.fit.suit_network import lines


def main() -> None:
    """Render scenes, train, write the network."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seeds", type=int, default=120, help="each makes 32 frames of the rig and 8 rooms")
    parser.add_argument("--minutes", type=float, default=60, help="of training, earlier runs included")
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    cv2.setNumThreads(given.threads)
    given.folder.mkdir(parents=True, exist_ok=True)
    for seed in range(1, given.seeds + 1):
        store_scenes(given.folder, seed)
    training = FinderTraining(load_scenes(given.folder), given.minutes)
    export_finder(train_finder(training, given.out.with_suffix(".safetensors"), lines(50)), given.out)


if __name__ == "__main__":
    main()
