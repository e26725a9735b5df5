"""Train the person finder: python -m tools.fit.finder FOLDER OUT.onnx [--start annotate/person/finder.onnx].

FOLDER keeps the rendered scenes, and OUT.safetensors the checkpoint: the same command resumes an interrupted
run.
"""

import argparse
from pathlib import Path

import cv2
import torch

from eval.training.finder.images import load_scenes, store_scenes
from eval.training.finder.network import RATE, FinderTraining, export_finder, train_finder
from tools.fit.suit_network import lines


def main() -> None:
    """Render scenes, train, write the network."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rigs", type=int, default=120, help="recordings of the rig, 32 frames each")
    parser.add_argument("--rooms", type=int, default=120, help="groups of 10 random rooms")
    parser.add_argument("--start", type=Path, help="ONNX file of the first weights; default: random ones")
    parser.add_argument("--rate", type=float, default=RATE, help="greatest learning rate")
    parser.add_argument("--steps", type=int, default=12_000, help="of 16 images, earlier runs included")
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    cv2.setNumThreads(given.threads)
    given.folder.mkdir(parents=True, exist_ok=True)
    store_scenes(given.folder, given.rigs, given.rooms)
    training = FinderTraining(load_scenes(given.folder), given.steps, given.rate)
    checkpoint = given.out.with_suffix(".safetensors")
    export_finder(train_finder(training, checkpoint, lines(50), given.start), given.out)


if __name__ == "__main__":
    main()
