"""Train the refinement network: python -m tools.fit.refinement_network FOLDER DATASET... [--workers 2].

It reads a network's labels again (`eval.network.refine`): of people on the virtual rig, whose suit it
does not see, and of those cut out in datasets. FOLDER gets examples, ``examples/NAME.npz``, the states of the
training, and ``reader.onnx``, for eval/weights/full/refine.onnx, from where tools.fit.quantise takes it.
Where it was broken off, the same command goes on.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch

from annotate.cloud.coarse import CoarseFuser
from annotate.crop import person_of
from annotate.label_recording import labels_of
from annotate.labelset.claim import Claim, login
from annotate.labelset.labelled_frames import open_frames
from annotate.parts import BACKGROUND
from annotate.segmentation.input_channels import CHANNELS, VALID, Rectangle
from annotate.segmentation.segment import OTHER_PERSON, SAMPLE_M
from annotate.segmentation.suit_network import SuitNetwork, flip_averaged
from eval.fine_tuning.by_depth import example_of
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict_source import NetworkSurvey
from eval.network.refine import camera_in
from eval.training.segmentation.examples import Example, Stock, store_examples
from eval.training.segmentation.fit import EXAMPLES, WEIGHTS, claim, fit
from eval.training.segmentation.network import FULL_READER, load_reader
from eval.training.segmentation.scenes import OTHER_RIGS
from eval.training.segmentation.train import Stage
from sensors.recording.rig_templates import REFERENCE
from synth.images.workers import processes
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import RigOptions, VirtualRig
from tools.fit.suit_network import HELD_OUT, SEED, lines

RIGS, SUBJECTS, FRAMES, FRAMES_PER_SECOND = 300, 8, 16, 0.5
"""Recordings, people and frames of each, and frames a second: few, so that no two look alike."""
FIRST_SEED, HARD, OTHER_RIG, COLD = 8_900_000, 0.3, 0.3, 0.5
"""Seed of the first recording; shares of `hard` ones, of those by another rig than the reference, and of
frames without temperature. Chosen by eye."""
PLACES = {"sofa": 0.3, "chair": 0.25, "bed": 0.25, "floor": 0.2}
"""Shares of the scenes. Chosen by eye."""
LEAST_IOU = 0.5
"""Least overlap of the network's outline with the person's: with less somebody else was labelled. Chosen by
eye."""
SHARD = 100
"""Frames of a dataset in one file."""
STAGES = (
    Stage(0.012, 128, 4_000, 1.5e-3, 0.998, spoilt=False),
    Stage(0.012, 128, 2_000, 1e-3, 0.998, spoilt=False),
)
"""First the network's labels are read; then in half of the files what was read of them, as `learn` meets it.
Chosen by eye."""


def main() -> None:
    """Make examples, train, write the network."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("datasets", type=Path, nargs="*")
    parser.add_argument("--workers", type=int, default=2, help="processes that make examples")
    given = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    claim(
        given.folder,
        {
            "seed": SEED,
            "stages": [asdict(stage) for stage in STAGES],
            "datasets": list(map(str, given.datasets)),
        },
    )
    with Claim.take(given.folder, login()):
        made = dict(_makers(given.folder / EXAMPLES, given.datasets))
        with processes(given.workers) as pool:
            missing = [(path, maker) for path, maker in made.items() if not path.exists()]
            for path in pool.executor.map(_store, *zip(*missing, strict=True)) if missing else ():
                print(path, flush=True)
        held_out = list(made)[HELD_OUT - 1 :: HELD_OUT]
        learnt = [path for path in made if path not in held_out]
        torch.manual_seed(SEED)
        once = given.folder / "once"
        if not (once / WEIGHTS).exists():
            once.mkdir(exist_ok=True)
            fit(load_reader(FULL_READER), Stock(learnt), Stock(held_out), STAGES[:1], once, SEED, lines())
        twice = [path if n % 2 else path.with_stem(f"{path.stem}-again") for n, path in enumerate(learnt)]
        missing = [path for path in twice if not path.exists()]
        with processes(given.workers) as pool:
            for path in pool.executor.map(partial(_store_again, once / WEIGHTS), missing):
                print(path, flush=True)
        start, stock = load_reader(once / WEIGHTS), Stock(twice)
        print(fit(start, stock, Stock(held_out), STAGES[1:], given.folder, SEED + 1, lines()))


Maker = Callable[[], Iterator[Example | None]]


def _makers(folder: Path, datasets: list[Path]) -> Iterator[tuple[Path, Maker]]:
    """Files of examples, and what makes them."""
    for number in range(RIGS):
        yield folder / f"rig-{number:03d}.npz", partial(of_rig, number)
    for dataset in datasets:
        for shard in range(-(-len(open_frames(dataset)) // SHARD)):
            yield folder / f"{dataset.name}-{shard:03d}.npz", partial(of_shard, dataset, shard)


def _store(path: Path, maker: Maker) -> Path:
    """Make the examples of a file."""
    store_examples((example for example in maker() if example is not None), path)
    return path


def _store_again(weights: Path, path: Path) -> Path:
    """Make a file's examples with the labels that a reader gives, in the place of the network's."""
    reader, first = SuitNetwork(weights), Stock([path.with_stem(path.stem.removesuffix("-again"))])

    def seen() -> Iterator[Example]:
        for n in range(len(first)):
            example = first[n]
            step = max(1, round(SAMPLE_M / example.pixel_m))
            everywhere = Rectangle(*(slice(0, side) for side in example.target.shape))
            named = flip_averaged(reader, example.planes, step, everywhere).argmax(axis=0).astype(np.uint8)
            there = (example.planes[0] & VALID > 0) & (named != OTHER_PERSON)
            example.planes[CHANNELS.index("before")] = np.where(there, named, np.uint8(BACKGROUND))
            yield example

    store_examples(seen(), path)
    return path


def of_rig(number: int) -> Iterator[Example | None]:
    """Examples of a recording of the virtual rig, the same for the same number from 0."""
    rng, network = np.random.default_rng((88003, number)), OnnxNetwork()
    difficulty = "hard" if rng.random() < HARD else "normal"
    scene = str(rng.choice(list(PLACES), p=list(PLACES.values())))
    kind = str(rng.choice(OTHER_RIGS)) if rng.random() < OTHER_RIG else REFERENCE
    seed = FIRST_SEED + number
    rig = VirtualRig(
        FRAMES, SUBJECTS, difficulty, seed, RigOptions(scene, FRAMES_PER_SECOND, rig=kind, draft=True)
    )
    fuser, camera = CoarseFuser(rig.calibration), rig.calibration.depth.undistorted()
    for frame, known in rig.with_truth():
        truth = truth_labels(frame, known, rig.calibration.depth).parts
        seen = replace(frame, color_encoded=None)
        seen = replace(seen, thermal_c=None) if rng.random() < COLD else seen
        cloud = fuser.fuse_frame(seen)
        found, person = NetworkSurvey(cloud, network).labels(None)
        first = labels_of("", cloud.depth_mm, found, person)
        own, true = person_of(first.parts), person_of(truth)
        if person.trusted and (own & true).sum() >= LEAST_IOU * (own | true).sum():
            yield example_of(first, truth, camera)


def of_shard(dataset: Path, shard: int) -> Iterator[Example | None]:
    """Examples of some frames of a dataset."""
    frames, network = open_frames(dataset), OnnxNetwork()
    for entry in list(frames.entries())[shard * SHARD : (shard + 1) * SHARD]:
        frame = frames.load(entry)
        first = replace(frame, parts=network.segment(frame.depth_mm, person_of(frame.parts)).parts)
        yield example_of(first, frame.parts, camera_in(frames, frame))


if __name__ == "__main__":
    main()
