"""Train the refinement network: python -m tools.fit.refinement_network FOLDER DATASET... [--workers 2].

It refines a network's labels (`eval.network.refine`), of people on the virtual rig without their suit's
colours, and of people cut out in datasets. ``--start`` trains given weights further, in one stage,
``--first`` chooses the recordings. FOLDER gets ``examples/NAME.npz``, checkpoints, and ``reader.onnx``, for
eval/weights/full/refine.onnx, from which tools.fit.quantise makes the quantised one. The same command resumes
an interrupted run. Constants are untuned.
"""

import argparse
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from annotate.label_recording import label_cloud
from annotate.labelset.claim import Claim, login
from annotate.labelset.dataset import sha256
from annotate.labelset.labelled_frames import open_frames
from annotate.scheme.scheme import BACKGROUND
from annotate.segmentation.input_channels import CHANNELS, VALID, Rectangle
from annotate.segmentation.labels_of_frame import labels_of
from annotate.segmentation.segment import SAMPLE_M
from annotate.segmentation.suit_network import SuitNetwork, flip_averaged, other_person
from eval.fine_tuning.by_depth import depth_example
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict_source import NetworkLabeller
from eval.network.refine import camera_in
from eval.training.segmentation.augmentation import Sampling
from eval.training.segmentation.examples import Example, ExampleFiles
from eval.training.segmentation.network import FULL_SUIT_NETWORK, load_suit_network
from eval.training.segmentation.scenes import ROOMS_WITH_THINGS, draw_filtered, draw_scene, wearers
from eval.training.segmentation.train import EXAMPLES, WEIGHTS, Stage, SuitTraining, claim, train_stages
from eval.training.segmentation.validation import Validation
from eval.training.shared_bodies import HELD_OUT, bodies_in
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import RigOptions, VirtualRig
from tools.fit import suit_network
from tools.fit.suit_network import LINE_STEPS, SEED, is_held_out, lines, make_files, split_files

SUBJECTS, FRAMES, FRAMES_PER_SECOND = 8, 16, 0.5  # few frames, because neighbours are alike
FIRST_SEED = 8_900_000  # of the first recording
HARD, OTHER_RIG = 0.4, 0.3  # shares of recordings
COLD = 0.5  # share of frames without temperature
LEAST_IOU = 0.5  # of the network's outline and the person's; below it another person was labelled
SHARD = 100  # frames of a dataset in one file
STAGES = (  # first on the network's labels; then, in half of the files, on labels that are already refined
    Stage(Sampling(0.012, 128, degrade=False), 4_000, 1.5e-3, 0.998),
    Stage(Sampling(0.012, 128, degrade=False), 2_000, 1e-3, 0.998),
)
CONTINUED = Stage(Sampling(0.012, 128, degrade=False), 2_500, 5e-4, 0.998, precision="bfloat16")
"""Of given weights, on both kinds of labels."""


def main() -> None:
    """Make examples, train, write the network."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("datasets", type=Path, nargs="*")
    parser.add_argument("--recordings", type=int, default=300, help="of the virtual rig")
    parser.add_argument("--first", type=int, default=0, help="number of the first recording")
    parser.add_argument("--start", type=Path, help="full-precision weights to train further")
    parser.add_argument("--workers", type=int, default=2, help="processes that make examples")
    given = parser.parse_args()
    suit_network.check_inputs(given.datasets)
    suit_network.one_thread()
    stages = (CONTINUED,) if given.start else STAGES
    plan = {"seed": SEED, "first": given.first, "recordings": given.recordings}
    start = sha256(given.start) if given.start else None
    settings = {"start": start, "datasets": list(map(str, given.datasets))}
    claim(given.folder, plan | settings | {"stages": [asdict(stage) for stage in stages]})
    with Claim.take(given.folder, login()):
        print(_trained(given))


def _trained(given: argparse.Namespace) -> Validation:
    """Make the missing examples, train the stages that are not finished; return the validation."""
    folder, once = given.folder, given.folder / "once"
    numbers = range(given.first, given.first + given.recordings)
    made = {
        path: partial(maker, is_held_out(number))
        for number, (path, maker) in enumerate(_makers(folder / EXAMPLES, numbers, given.datasets))
    }
    make_files(made, given.workers)
    learnt, held_out = split_files(list(made))
    torch.manual_seed(SEED)
    if not given.start and not (once / WEIGHTS).exists():
        once.mkdir(exist_ok=True)
        _train(FULL_SUIT_NETWORK, SuitTraining(ExampleFiles(learnt), STAGES[0], SEED), held_out, once)
    first = given.start or once / WEIGHTS
    refined = {path.with_stem(f"{path.stem}-again"): path for path in learnt[::2]}
    again = {path: partial(of_refined, first, labels) for path, labels in refined.items()}
    make_files(again, given.workers)
    examples = ExampleFiles([*learnt[1::2], *refined])
    last = CONTINUED if given.start else STAGES[1]
    return _train(first, SuitTraining(examples, last, SEED + 1), held_out, folder)


def _train(start: Path, training: SuitTraining, held_out: list[Path], out: Path) -> Validation:
    network = load_suit_network(start)
    return train_stages(network, [training], ExampleFiles(held_out), out, lines(LINE_STEPS))


def _makers(
    folder: Path, numbers: Iterable[int], datasets: list[Path]
) -> Iterator[tuple[Path, Callable[[bool], Iterator[Example | None]]]]:
    """Yield files of examples, and their makers by whether the file is held out."""
    for number in numbers:
        yield folder / f"rig-{number:03d}.npz", partial(of_rig, number)
    for dataset in datasets:
        for shard in range(-(-len(open_frames(dataset)) // SHARD)):
            yield folder / f"{dataset.name}-{shard:03d}.npz", partial(of_shard, dataset, shard)


def of_refined(weights: Path, path: Path) -> Iterator[Example]:
    """Yield a file's examples with labels by a refinement network in the place of the first labels."""
    network, first = SuitNetwork(weights), ExampleFiles([path])
    for n in range(len(first)):
        example = first[n]
        step = max(1, round(SAMPLE_M / example.pixel_m))
        everywhere = Rectangle(*(slice(0, side) for side in example.target.shape))
        named = flip_averaged(network, example.planes, step, everywhere).argmax(axis=0).astype(np.uint8)
        there = (example.planes[0] & VALID > 0) & (named != other_person(network.own))
        example.planes[CHANNELS.index("before")] = np.where(there, named, np.uint8(BACKGROUND))
        yield example


def of_rig(number: int, held_out: bool) -> Iterator[Example | None]:
    """Yield examples of a recording of the virtual rig, the same for the same number from 0.

    held_out: its people have the bodies that are not trained on.
    """
    rng, seed = np.random.default_rng((88003, number)), FIRST_SEED + number
    difficulty, scene, kind = draw_scene(rng, HARD, ROOMS_WITH_THINGS, OTHER_RIG)
    stereo, bodies = draw_filtered(rng), wearers(held_out)
    options = RigOptions(scene, FRAMES_PER_SECOND, rig=kind, draft=True, wearers=bodies, camera=stereo)
    rig = VirtualRig(FRAMES, SUBJECTS, difficulty, seed, options)
    labeller, camera = NetworkLabeller(OnnxNetwork()), rig.calibration.depth.undistorted()
    fuser = labeller.fuser(rig.calibration)
    for frame, known in rig.with_truth():
        truth = truth_labels(frame, known, rig.calibration.depth)
        bare = replace(frame, color_encoded=None)
        bare = replace(bare, thermal_c=None) if rng.random() < COLD else bare
        cloud = fuser.fuse_frame(bare)
        found, person = label_cloud(labeller, cloud, None)
        first = labels_of("", cloud.depth_mm, found, person)
        own, true = first.on_person, truth.on_person
        if person.trusted and (own & true).sum() >= LEAST_IOU * (own | true).sum():
            yield depth_example(first, truth, camera)


def of_shard(dataset: Path, shard: int, held_out: bool) -> Iterator[Example | None]:
    """Yield examples of some frames of a dataset: of people who share a held-out body, or of the others."""
    frames, network = open_frames(dataset), OnnxNetwork()
    for entry in list(frames.entries())[shard * SHARD : (shard + 1) * SHARD]:
        frame = frames.load(entry)
        if bodies_in(frames, frame).isdisjoint(HELD_OUT) == held_out:
            continue
        found = network.segment(frame.depth_mm, frame.on_person)
        first = replace(frame, parts=found.parts, scheme=found.scheme)
        yield depth_example(first, frame, camera_in(frames, frame))


if __name__ == "__main__":
    main()
