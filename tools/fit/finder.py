"""Train the person finder: ``python -m tools.fit.finder FOLDER OUT.onnx [--start FINDER.onnx]``.

FOLDER keeps the rendered scenes, and OUT.safetensors the checkpoint: the same command resumes an interrupted
run. The training takes the GPU if any, and all scenes in FOLDER.
"""

import argparse
from pathlib import Path

import cv2
import torch

from eval.training.finder.network import RATE, FinderTraining, export_finder, train_finder
from eval.training.finder.stored import load_scenes, store_scenes
from tools.fit.suit_network import lines


def main() -> None:
    """Render scenes, train, write the network."""
    given = _parser().parse_args()
    torch.set_num_threads(given.threads)
    cv2.setNumThreads(given.threads)
    given.folder.mkdir(parents=True, exist_ok=True)
    counts = {"close": given.close, "room": given.rooms, "rig": given.rigs, "empty": given.empty}
    store_scenes(given.folder, counts, given.seed_from, given.workers)
    if given.render_only:
        return
    workers = given.workers if given.workers > 1 else 0
    training = FinderTraining(load_scenes(given.folder), given.steps, given.rate, given.minutes, workers)
    checkpoint = given.out.with_suffix(".safetensors")
    export_finder(train_finder(training, checkpoint, lines(50), given.start), given.out)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rigs", type=int, default=120, help="recordings of the rig, 32 frames each")
    parser.add_argument("--rooms", type=int, default=120, help="groups of 10 random rooms")
    parser.add_argument("--close", type=int, default=120, help="groups of 10 close rooms")
    parser.add_argument("--empty", type=int, default=0, help="groups of 10 empty rooms, for the second stage")
    parser.add_argument("--seed-from", type=int, default=1, help="first seed of each kind of scene")
    parser.add_argument("--render-only", action="store_true", help="render missing scenes, do not train")
    parser.add_argument("--start", type=Path, help="ONNX file of the first weights; default: random ones")
    parser.add_argument("--rate", type=float, default=RATE, help="greatest learning rate")
    parser.add_argument("--steps", type=int, default=12_000, help="of 16 images, earlier runs included")
    parser.add_argument("--minutes", type=float, help="of training, instead of --steps; rendering excluded")
    parser.add_argument("--threads", type=int, default=1, help="of the training on a processor")
    parser.add_argument("--workers", type=int, default=1, help="processes that render, then draw batches")
    return parser


if __name__ == "__main__":
    main()
