"""Train the finder's second stage: ``python -m tools.finder.verifier FOLDER OUT.onnx``.

FOLDER has scenes by ``tools.fit.finder --render-only``, with empty rooms; give scenes that the finder was not
trained on. OUT.safetensors is the checkpoint: the same command resumes an interrupted training. It computes
the candidates again each time.
"""

import argparse
from functools import reduce
from itertools import chain
from pathlib import Path

import torch

from eval.training.finder.stored import load_scenes
from eval.training.finder.verification import Examples, VerifierTraining, export_verifier, train_verifier
from eval.training.finder.verification_examples import examples_of
from synth.random_stream import stream
from tools.fit.suit_network import lines


def main() -> None:
    """Compute candidates, train, write the network."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--steps", type=int, default=6_000, help="steps of 64 candidates (default 6000)")
    parser.add_argument("--augmentations", type=int, default=1, help="images of each scene (default 1)")
    given = parser.parse_args()
    torch.set_num_threads(1)
    images = list(chain(*load_scenes(given.folder)))
    streams = (stream(0, "candidates", number) for number in range(given.augmentations))
    examples = reduce(Examples.joined, (examples_of(images, rng) for rng in streams))
    training = VerifierTraining(examples, given.steps)
    checkpoint = given.out.with_suffix(".safetensors")
    export_verifier(train_verifier(training, checkpoint, lines(50)), given.out)


if __name__ == "__main__":
    main()
