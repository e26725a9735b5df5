"""Train the witness network: python -m tools.fit.witness_network FOLDER [DATASET ...] [--recordings 48].

Examples show people of the virtual rig's training recordings, and people cut out in DATASETs of ``synth
generate``, training cast. A simulated witness with errors (``WitnessErrors``) gives each person a mask and
joints; the fused probabilities of the parts are the network's input. FOLDER gets ``examples/NAME.npz``,
checkpoints, and ``reader.onnx``, from which tools.fit.quantise makes
``annotate/witness/witness_network.onnx``. The same command resumes an interrupted run. Constants are
untuned.
"""

import argparse
import zlib
from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import torch

from annotate.array_types import Bool
from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.frame_labels import FrameLabels
from annotate.labelset.claim import Claim, login
from annotate.labelset.labelled_frames import camera_of, open_frames, pinhole_of
from annotate.parts import PAPER
from annotate.person.extract import PersonDetection
from annotate.scheme.merging import conversion_table
from annotate.segmentation.segment import SAMPLE_M
from annotate.witness.coloured_cloud import ColouredCloud, ColourFuser
from annotate.witness.person_crop import crop_of_points
from annotate.witness.person_outline import person_outline
from annotate.witness.pose_network import PosedPerson
from eval.network.colour.witness_network import witness_view
from eval.network.colour.witnessed_body import witnessed_body
from eval.network.onnx_network import OnnxNetwork
from eval.training.segmentation.augmentation import Sampling
from eval.training.segmentation.examples import Example, ExampleFiles
from eval.training.segmentation.network import FULL_SUIT_NETWORK, load_suit_network
from eval.training.segmentation.scenes import training_rig
from eval.training.segmentation.train import EXAMPLES, WEIGHTS, Stage, SuitTraining, claim, train_stages
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, RigCalibration
from synth.rig.truth import truth_labels
from tools.fit.suit_network import (
    LINE_STEPS,
    SEED,
    check_inputs,
    is_held_out,
    lines,
    make_files,
    one_thread,
    split_files,
)
from tools.fit.witness_errors import NAMES, WitnessErrors, mask_with_errors

SHARD, MOST = 60, 300  # frames of a dataset in one file, and in all
COLD = 0.7  # share of frames whose people are found without temperature
SIZES = (1.0, 2.0)  # of the witness's errors
HIDING, HIDDEN = 0.4, 4  # share of people with this many landmarks more hidden
BESIDE_M = (0.05, 0.015, 0.01)  # deviation of the colour camera's place; half of the cameras are aligned
LEAST_PX, LEAST_IOU = 400, 0.5  # of a person; of the found outline and the true one
STAGE = Stage(Sampling(SAMPLE_M, 160, degrade=False), 2_500, 5e-4, 0.995, precision="bfloat16")


def main() -> None:
    """Make examples, train, write the network."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("datasets", type=Path, nargs="*")
    parser.add_argument("--recordings", type=int, default=48, help="of the virtual rig, 32 frames each")
    parser.add_argument("--workers", type=int, default=2, help="processes that make examples")
    given = parser.parse_args()
    check_inputs(given.datasets)
    one_thread()
    examples, plan = given.folder / EXAMPLES, {"recordings": given.recordings, "stage": asdict(STAGE)}
    claim(given.folder, plan | {"seed": SEED, "datasets": list(map(str, given.datasets))})
    with Claim.take(given.folder, login()):
        made = {
            examples / f"rig-{n:03d}.npz": partial(of_rig, n, is_held_out(n)) for n in range(given.recordings)
        }
        _, held_out = split_files(list(made))
        for path in given.datasets:
            for start in range(0, min(MOST, len(open_frames(path))), SHARD):
                made[examples / f"{path.name}-{start:03d}.npz"] = partial(of_shard, path, start)
        make_files(made, given.workers)
        learnt = ExampleFiles([file for file in made if file not in held_out])
        torch.manual_seed(SEED)
        training, network = SuitTraining(learnt, STAGE, SEED), load_suit_network(FULL_SUIT_NETWORK)
        found = train_stages(network, [training], ExampleFiles(held_out), given.folder, lines(LINE_STEPS))
    print(f"{given.folder / WEIGHTS}: {found}")


def of_rig(number: int, held_out: bool) -> Iterator[Example | None]:
    """Yield the examples of a recording of the virtual rig; None for an unusable frame.

    held_out: its people have the bodies that are not trained on.
    """
    rig, network = training_rig(number, held_out), OnnxNetwork(flip=False)
    fuser, rng = Fuser(rig.calibration), np.random.default_rng((SEED, number))
    for frame, known in rig.with_truth():
        truth = truth_labels(frame, known, rig.calibration.depth)
        bare = replace(frame, color_encoded=None)
        bare = replace(bare, thermal_c=None) if rng.random() < COLD else bare
        found = PersonDetection(CoarseCloud.of(fuser.fuse_frame(bare))).person().mask
        true = truth.on_body & (truth.persons == 1) & (truth.depth_mm > 0)
        if true.sum() >= LEAST_PX and (found & true).sum() >= LEAST_IOU * (found | true).sum():
            yield example_of(truth, found, fuser.camera, network, rng)


def of_shard(path: Path, start: int) -> Iterator[Example | None]:
    """Yield the examples of some frames of a dataset; None for an unusable frame."""
    frames, network = open_frames(path), OnnxNetwork(flip=False)
    for entry in islice(frames.entries(), start, start + SHARD):
        frame = frames.load(entry)
        own = frame.on_body & (frame.depth_mm > 0)
        if own.sum() >= LEAST_PX:
            rng = np.random.default_rng((SEED, zlib.crc32(f"{path.name} {frame.frame_id}".encode())))
            yield example_of(frame, own, pinhole_of(frame, camera_of(frames, frame)), network, rng)


def example_of(
    truth: FrameLabels, found: Bool, camera: Intrinsics, network: OnnxNetwork, rng: np.random.Generator
) -> Example | None:
    """Return a person's example with a simulated witness; None where the witness shows no person.

    found: the person's pixels (h, w) by depth.
    """
    size = float(rng.choice(SIZES))
    cloud, person = witnessed(truth, (camera, WitnessErrors().times(size), size), rng)
    if rng.random() < HIDING:
        person.landmarks[rng.choice(len(NAMES), HIDDEN, replace=False), 2] = 0
    shown = person_outline(cloud, person, NAMES, found)
    if shown is None:
        return None
    view = witness_view(cloud.cloud, witnessed_body(cloud.cloud, shown, shown.mask, network))
    if view is None:
        return None
    parts = conversion_table(truth.scheme, PAPER)[truth.parts[view.where]]
    meta = np.array([camera.fx, camera.fx / view.pixels_per_m])
    return Example(view.planes, PAPER.class_table[parts], meta)


def witnessed(
    frame: FrameLabels, how: tuple[Intrinsics, WitnessErrors, float], rng: np.random.Generator
) -> tuple[ColouredCloud, PosedPerson]:
    """Return a frame's cloud beside a colour camera, and its person as a witness with errors shows it.

    how: the depth camera, the landmarks' errors, and the size of the mask's errors.
    """
    own = frame.on_body & (frame.depth_mm > 0)
    if frame.persons is not None:
        own &= frame.persons == 1
    camera, errors, size = how
    beside_m = rng.normal(0, BESIDE_M) if rng.random() < 0.5 else np.zeros(3)
    pose, shape = Pose(np.eye(3), beside_m), frame.depth_mm.shape
    fuser = ColourFuser(RigCalibration(camera, color=camera, color_from_depth=pose))
    cloud = fuser.fuse(frame.depth_mm, np.zeros((*shape, 3), np.uint8))
    joints_m = pose.apply(np.array(frame.notes["joints_mm"], np.float64) / 1000)
    at_px = cloud.surface(own).at_px
    crop = crop_of_points(at_px)
    assert crop is not None
    mask = mask_with_errors(at_px, crop, rng, size)
    landmarks = errors.landmarks(joints_m, camera, rng)
    return cloud, PosedPerson(landmarks, crop, crop.pasted(mask, (shape[0], shape[1])))


if __name__ == "__main__":
    main()
