"""Train the correction of joints: ``python -m tools.fit.joint_correction FOLDER DATASET... --test DATASET``.

DATASET: of ``synth generate``, or of tools.fit.rig_people. A third of the images show a person cut off at a
random border. FOLDER keeps the depth network's joints of each dataset, so an interrupted run continues. Every
second person of the datasets after ``--test`` calibrates the deviations; the tool prints the errors of the
others and writes eval/weights/joints.onnx. Constants are untuned.
"""

import argparse
import sys
from collections.abc import Iterable
from dataclasses import astuple, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from annotate.array_types import Bool, Float64, UInt8, UInt16
from annotate.crop import network_crop, normalize
from annotate.labelset.labelled_frames import camera_of, open_frames, pinhole_of
from eval.network.body_state import BodyState
from eval.network.joints.joint_correction import FEATURES, LocalJoints
from eval.network.joints.region_places import region_places
from eval.network.onnx_export import export_crops, halve_onnx
from eval.network.onnx_network import OnnxNetwork
from eval.scores.joint_errors import TRUE_JOINTS, joint_visibility, true_joints_mm
from eval.scores.joint_visibility import VISIBILITIES
from eval.scores.joints import N_JOINTS, TWIN
from sensors.files.atomic import replacing
from sensors.rig.camera import Intrinsics
from tools.fit.posture import LEAST_PX, cut
from tools.fit.suit_network import check_inputs, lines

OUT = Path(__file__).resolve().parents[2] / "eval" / "weights" / "joints.onnx"
WIDTH, DROPPED = 768, 0.1  # of the layers
BATCH, RATE, DECAY = 256, 2e-3, 1e-2
SMOOTH_MM = 5.0  # below it an error weighs by its square
MOST_DEVIATIONS, MOST_LOG = 4.0, 1.5  # bounds of a shift, and of a deviation's logarithmic factor
MOST_SCALED = 6.0  # bound of the inputs, in their standard deviations
WITHIN = 0.683  # share of a normal distribution within one standard deviation
CUT = 1 / 3  # share of people cut off
STATE_COLUMNS = ("joints_px", "joints_sd", "joints_seen", "facing", "posture", "places")
COLUMNS = (*STATE_COLUMNS, "pinhole", "true_mm", "visibility")
Person = tuple[LocalJoints, Float64, UInt8]
"""Joints of a person, true joints (15, 3) in millimetres, and their visibility (15,)."""


class Examples(NamedTuple):
    """Joints of n people, in millimetres.

    features: (n, F), inputs. joints, deviations: (n, 15, 3), about the middle. rays, distances: (n, 2) and
    (n,), of the middles. true: (n, 15, 3), in the camera's frame. visibility: (n, 15).
    """

    features: Tensor
    joints: Tensor
    deviations: Tensor
    rays: Tensor
    distances: Tensor
    true: Tensor
    visibility: Tensor

    @classmethod
    def of(cls, people: list[Person]) -> "Examples":
        """Return the examples of joints, true joints (15, 3) and visibilities (15,)."""
        columns = [
            (one.features(), one.joints_mm, one.deviations_mm, one.ray, one.middle_mm, true, seen)
            for one, true, seen in people
        ]
        arrays = (np.array(column, np.float32) for column in zip(*columns, strict=True))
        return cls(*map(torch.from_numpy, arrays))

    def at(self, chosen: Tensor) -> "Examples":
        """Return the examples at indices (k,) or flags (n,)."""
        return Examples(*(one[chosen] for one in self))

    def placed(self, local: Tensor) -> Tensor:
        """Return joints in the camera's frame from joints about their middle, both (n, 15, 3)."""
        z = self.distances[:, None] + local[..., 2]
        rays = self.rays[:, None] + local[..., :2] / self.distances[:, None, None]
        return torch.cat([rays * z[..., None], z[..., None]], dim=-1)


class JointNet(nn.Module):
    """Layers with residuals: inputs (n, F) -> shifts in deviations and logarithmic factors (n, 15, 5)."""

    def __init__(self, width: int = WIDTH) -> None:
        super().__init__()
        self.mean = nn.Parameter(torch.zeros(FEATURES), requires_grad=False)
        self.scale = nn.Parameter(torch.ones(FEATURES), requires_grad=False)
        self.calibration = nn.Parameter(torch.zeros(len(VISIBILITIES)), requires_grad=False)
        self.first = nn.Linear(FEATURES, width)
        self.layers = nn.ModuleList(nn.Linear(width, width) for _ in range(2))
        self.last = nn.Linear(width, 5 * N_JOINTS)
        self.dropped = nn.Dropout(DROPPED)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(self, features: Tensor) -> Tensor:
        scaled = ((features - self.mean) / self.scale).clamp(-MOST_SCALED, MOST_SCALED)
        x = functional.gelu(self.first(scaled))
        for layer in self.layers:
            x = x + functional.gelu(layer(self.dropped(x)))
        out = self.last(self.dropped(x)).view(-1, N_JOINTS, 5)
        shifts = MOST_DEVIATIONS * torch.tanh(out[..., :3] / MOST_DEVIATIONS)
        logs = MOST_LOG * torch.tanh(out[..., 3:] / MOST_LOG)
        seen = features[:, 5 * N_JOINTS : (5 + len(VISIBILITIES)) * N_JOINTS]
        by_seen = seen.view(-1, N_JOINTS, len(VISIBILITIES)) @ self.calibration
        return torch.cat([shifts, logs + by_seen[..., None]], dim=-1)


def store_joints(dataset: Path, network: OnnxNetwork, out: Path) -> None:
    """Write the depth network's joints of a dataset's people, and the true ones, as NPZ: ``COLUMNS``."""
    rng, frames, rows = np.random.default_rng(0), open_frames(dataset), []
    for frame in frames:
        person = frame.on_person & (frame.depth_mm > 0)
        if rng.random() < CUT and np.count_nonzero(part := cut(person, rng)) >= LEAST_PX:
            person = part
        if TRUE_JOINTS not in frame.notes or not person.any():
            continue
        camera = camera_of(frames, frame)
        kept = replace(frame, depth_mm=np.where(person, frame.depth_mm, np.uint16(0)))
        true = true_joints_mm(frame), joint_visibility(kept, camera)
        rows.append(
            (*_network_joints(frame.depth_mm, person, network), astuple(pinhole_of(frame, camera)), *true)
        )
    if not rows:
        sys.exit(f"{dataset} has 0 people with true joints; give a dataset of `synth generate`")
    with replacing(out) as temporary, temporary.open("wb") as file:
        columns = map(np.array, zip(*rows, strict=True))
        np.savez_compressed(file, **dict(zip(COLUMNS, columns, strict=True)))  # type: ignore[arg-type]


def _network_joints(depth_mm: UInt16, person: Bool, network: OnnxNetwork) -> tuple[Any, ...]:
    """Return ``STATE_COLUMNS`` for a person's pixels in a depth image, both (h, w)."""
    crop = network_crop(person)
    depth = normalize(crop.cut(depth_mm, 0), crop.cut(person, False))
    planes, *body = (one[0] for one in network.outputs(depth[None]))
    state = BodyState.of(crop, (depth_mm, person), tuple(body))
    places = region_places(crop, (depth_mm, person), planes, network.own)
    return state.joints_px, state.joints_sd, state.joints_seen, state.facing, state.posture, places


def examples_in(paths: Iterable[Path]) -> tuple[Examples, Examples]:
    """Return the examples in files of ``store_joints``, and their mirror images."""
    own, mirrored = list[Person](), list[Person]()
    for path in paths:
        with np.load(path) as stored:
            for row in zip(*(stored[name] for name in COLUMNS), strict=True):
                joints_px, joints_sd, joints_seen, facing, posture, *known = row
                places, pinhole, true_mm, seen = known
                azimuth, sure = np.degrees(np.arctan2(*facing[::-1])), np.hypot(*facing)
                qualities = {"joints_sd": joints_sd, "joints_seen": joints_seen}
                state = BodyState(azimuth, sure, posture, joints_px, **qualities)
                camera = Intrinsics(*map(int, pinhole[:2]), *pinhole[2:])
                local = LocalJoints.of(state, camera, places)
                own.append((local, true_mm, seen))
                mirrored.append((local.mirrored(), true_mm[TWIN] * (-1, 1, 1), seen[TWIN]))
    return Examples.of(own), Examples.of(mirrored)


def trained(own: Examples, mirrored: Examples, steps: int, width: int = WIDTH) -> JointNet:
    """Return a network trained on examples and on their mirror images."""
    torch.manual_seed(0)
    network, both = JointNet(width), Examples(*map(torch.cat, zip(own, mirrored, strict=True)))
    network.mean.data, network.scale.data = both.features.mean(dim=0), both.features.std(dim=0) + 1e-2
    optimiser = torch.optim.AdamW(network.parameters(), RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, steps)
    watch = lines(max(1, steps // 20))
    for step in range(1, steps + 1):
        batch = both.at(torch.randint(len(both.features), (BATCH,)))
        loss = losses(network(batch.features), batch).mean()
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
        watch(step, loss.item())
    return network.eval()


def losses(out: Tensor, batch: Examples) -> Tensor:
    """Return losses (n, 15): each joint's error, and how unlikely it is by its deviations."""
    off = batch.placed(batch.joints + out[..., :3] * batch.deviations) - batch.true
    errors = torch.sqrt(off.square().sum(dim=-1) + SMOOTH_MM**2) / 10
    squares = torch.stack([off[..., :2].square().sum(dim=-1), off[..., 2].square()], dim=-1).detach()
    variances = (batch.deviations[..., 1:] * torch.exp(out[..., 3:])).square() + 1
    axes = torch.tensor([2.0, 1.0])  # a deviation in the image is of two directions
    return errors + 0.5 * (axes * variances.log() + axes * squares / variances).sum(dim=-1)


def tested(network: JointNet, own: Examples, mirrored: Examples) -> tuple[Tensor, Tensor]:
    """Return errors and deviations (n, 15), millimetres, averaged over mirror images."""
    with torch.no_grad():
        other = network(mirrored.features)[:, TWIN] * torch.tensor([-1.0, 1, 1, 1, 1])
        out = (network(own.features) + other) / 2
    placed = own.placed(own.joints + out[..., :3] * own.deviations)
    return _errors(placed, own), (own.deviations[..., 1:] * torch.exp(out[..., 3:])).norm(dim=-1)


def calibrate(network: JointNet, own: Examples, mirrored: Examples) -> None:
    """Set the factors of the deviations: 68 % of the errors of each visibility lie within one deviation."""
    errors, deviations = tested(network, own, mirrored)
    for i in range(len(VISIBILITIES)):
        ratios = (errors / deviations)[own.visibility == i]
        if len(ratios):
            network.calibration.data[i] = ratios.quantile(WITHIN).log()


def _errors(joints: Tensor, examples: Examples) -> Tensor:
    """Return the errors (n, 15) of joints (n, 15, 3) in the camera's frame, millimetres."""
    errors: Tensor = torch.linalg.vector_norm(joints - examples.true, dim=-1)
    return errors


def report(name: str, errors: Tensor, deviations: Tensor, seen: Tensor) -> None:
    """Print the scores of errors and deviations (n, 15) by visibility."""
    for i, visibility in enumerate(VISIBILITIES):
        own = seen == i
        error, ratio = errors[own], errors[own] / deviations[own]
        shares = [(error < 50), (error < 100), (ratio < 1), (ratio < 2)]
        print(f"{name}, {visibility}: {error.mean():.1f} mm; within 50 mm, 100 mm, 1 sd, 2 sd", end=" ")
        print(", ".join(f"{share.float().mean():.3f}" for share in shares))


def main() -> None:
    """Store the depth network's joints, train, print the scores, write the network."""
    given = _parser().parse_args()
    check_inputs([*given.datasets, *given.test])
    given.folder.mkdir(parents=True, exist_ok=True)
    network, files = OnnxNetwork(), dict[Path, Path]()
    for dataset in (*given.datasets, *given.test):
        key = sha256(f"{network.sha256} {dataset.resolve()}".encode()).hexdigest()[:16]
        files[dataset] = given.folder / f"{key}.npz"
        if not files[dataset].exists():
            store_joints(dataset, network, files[dataset])
    correction = trained(*examples_in(files[one] for one in given.datasets), given.steps)
    own, mirrored = examples_in(files[one] for one in given.test)
    half = torch.arange(len(own.features)) % 2 == 0
    found = own.at(~half)
    before = _errors(found.placed(found.joints), found), found.deviations[..., 1:].norm(dim=-1)
    report("before", *before, found.visibility)
    calibrate(correction, own.at(half), mirrored.at(half))
    report("after", *tested(correction, own.at(~half), mirrored.at(~half)), own.visibility[~half])
    export_crops(correction, OUT, own.features[:2], ["joints", "moved"])
    halve_onnx(OUT)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("datasets", type=Path, nargs="+")
    parser.add_argument("--test", type=Path, nargs="+", required=True)
    parser.add_argument("--steps", type=int, default=6_000)
    return parser


if __name__ == "__main__":
    main()
