"""Fit how far points lie from a witness's limbs: ``python -m tools.fit.witness OUT.json DATASET ...``.

DATASET: of ``synth generate --scheme atlas``, training cast. A simulated witness gives each person's joints
with errors (``WitnessErrors``), and the depth network gives its probabilities. The parameters of
``annotate.witness.fusion.Spreads`` maximise the likelihood of the true regions. In a third of the images some
points have wrong probabilities by depth, because the network is right less often on real people.
"""

import argparse
import json
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from annotate.array_types import Float32, UInt8
from annotate.crop import crop_around, nearest_seen, normalize
from annotate.labelset.labelled_frames import LabelledFrames, camera_of, open_frames, pinhole_of
from annotate.parts import PAPER
from annotate.scheme.regions import N_REGIONS, Region
from annotate.scheme.scheme import Scheme
from annotate.witness.fusion import KIND, KINDS, depth_chance, head_by_depth
from annotate.witness.limbs import distances
from annotate.witness.skeleton import Surface, skeleton_of
from eval.network.onnx_network import OnnxNetwork
from sensors.files.atomic import write_bytes
from sensors.rig.camera import project, unproject
from sensors.rig.rig_calibration import Pose
from tools.fit.suit_network import check_inputs
from tools.fit.witness_errors import NAMES, WitnessErrors

PIXELS = 100  # of each person
STEPS = 200
DOUBT = 0.06  # share of joints whose part by depth is wrong on cut-out real people (model card)
PEOPLE = 70  # of each dataset
WRONG = 0.36  # six percent of all points, as DOUBT; most points of an image with wrong probabilities


class Sample(NamedTuple):
    """Points of people: distances and uncertainty (n, 24), probability of the
    region's part by depth (n, 24), true region (n,)."""

    far: Float32
    sd: Float32
    chance: Float32
    truth: UInt8


def samples(frames: LabelledFrames, network: OnnxNetwork, rng: np.random.Generator) -> Iterator[Sample]:
    """Yield the sampled points of each person of a dataset, up to ``PEOPLE``."""
    for entry in islice(frames.entries(), PEOPLE):
        frame = frames.load(entry)
        mask = frame.on_body & (frame.depth_mm > 0)
        joints_mm = np.array(frame.notes.get("joints_mm", ()), np.float64)
        if joints_mm.size == 0 or mask.sum() < PIXELS:
            continue
        camera = pinhole_of(frame, camera_of(frames, frame))
        landmarks = WitnessErrors().landmarks(joints_mm / 1000, camera, rng)
        points = unproject(camera, frame.depth_mm / 1000)
        at = project(camera, points[mask]) + 0.5
        surface = Surface(at, points[mask][:, 2], camera, Pose.identity())
        if (landmarks[:, 2] >= 0.3).sum() < 4:
            continue
        crop = crop_around(mask)
        depth = normalize(crop.cut(frame.depth_mm, 0), crop.cut(mask, False))
        planes, *body = network.outputs(depth[None])
        image, outputs = (frame.depth_mm, mask), [one[0] for one in body]
        state = network.body_state(crop, image, outputs, planes[0], camera)
        chosen = rng.choice(np.flatnonzero(mask), PIXELS, replace=False)
        pixel, some = (
            crop.paste(nearest_seen(depth > 0), mask.shape, 0).ravel()[chosen],
            points.reshape(-1, 3)[chosen],
        )
        own = disturbed(planes[0].reshape(len(planes[0]), -1)[:, pixel], network.own, rng)
        head = own[network.own.class_table[network.own.table[Region.HEAD]]]
        skeleton = head_by_depth(skeleton_of(landmarks, NAMES, surface), some, head)
        skeleton = skeleton.completed(state.joints_mm(camera) / 1000)
        far, sd = distances(some, skeleton)
        chance = depth_chance(own, network.own).T
        yield Sample(far, np.tile(sd, (PIXELS, 1)), chance, frame.parts.ravel()[chosen])


def disturbed(planes: Float32, own: Scheme, rng: np.random.Generator) -> Float32:
    """Return probabilities (k, n); in a third of the images a part of the points has the other side's or
    another point's probabilities.
    """
    if rng.random() < 2 / 3:
        return planes
    wrong = rng.random(planes.shape[1]) < WRONG * rng.random()
    other = planes[own.twin_classes] if rng.random() < 0.3 else planes[:, rng.permutation(planes.shape[1])]
    return np.where(wrong, other, planes)


def fit(sample: Sample) -> dict[str, object]:
    """Return the parameters by kind that maximise the likelihood of the true regions."""
    n = len(KINDS)
    far, sd, chance = (torch.nan_to_num(torch.tensor(one), nan=9.0) for one in sample[:3])
    truth, kind = torch.tensor(sample.truth.astype(np.int64)) - 1, torch.tensor(KIND)
    radius, spread = torch.full((n,), -2.5, requires_grad=True), torch.full((n,), -2.5, requires_grad=True)
    weight, bias = torch.zeros(n, requires_grad=True), torch.zeros(n, requires_grad=True)
    trust = torch.tensor(0.0, requires_grad=True)
    all_of = [radius, spread, weight, bias, trust]
    optimiser = torch.optim.Adam(all_of, lr=0.1)
    for _ in range(STEPS):
        wide = torch.hypot(spread.exp()[kind], sd)
        off = torch.relu(far - radius.exp()[kind]) / wide
        evidence = torch.log((1 - DOUBT) * chance + DOUBT / len(PAPER.class_ids))
        score = trust.exp() * evidence + bias[kind] - weight.exp()[kind] * torch.log1p(off**2)
        loss = torch.nn.functional.cross_entropy(score, truth)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    print(f"loss {loss.item():.4f}, right {(score.argmax(1) == truth).float().mean().item():.4f}")
    rows = (radius.exp(), spread.exp(), weight.exp(), bias)
    named = zip(("radius", "spread", "weight", "bias"), rows, strict=True)
    by_name = {name: [round(value, 4) for value in row.tolist()] for name, row in named}
    kinds = {kind: {name: row[k] for name, row in by_name.items()} for k, kind in enumerate(KINDS)}
    return {"trust": round(trust.exp().item(), 4), "doubt": DOUBT, "kinds": kinds}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("datasets", type=Path, nargs="+")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    check_inputs(options.datasets)
    network, rng = OnnxNetwork(flip=False), np.random.default_rng(options.seed)
    found = [sample for path in options.datasets for sample in samples(open_frames(path), network, rng)]
    sample = Sample(*(np.concatenate(column) for column in zip(*found, strict=True)))
    known = (sample.truth >= 1) & (sample.truth <= N_REGIONS)
    fields = fit(Sample(*(column[known] for column in sample)))
    write_bytes(options.out, (json.dumps(fields, indent=1) + "\n").encode())


if __name__ == "__main__":
    main()
