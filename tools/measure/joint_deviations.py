"""Errors of a network's corrected joints, and how honest their deviations are.

``python -m tools.measure.joint_deviations WEIGHTS.onnx LABELS...`` prints a table for each dataset, a row
each for hidden, visible and outside joints. Columns: mean error; shares of the errors within 50 and 100 mm,
and within one and two deviations; mean deviation; share of the joints whose visibility is named right. A
person is cut out as labelled.
"""

import sys
from pathlib import Path

import numpy as np

from annotate.array_types import Float64, UInt8
from annotate.labelset.labelled_frames import LabelledFrames, camera_of, open_frames, pinhole_of
from eval.network.body_state import BodyState
from eval.network.onnx_network import OnnxNetwork
from eval.scores.joint_errors import TRUE_JOINTS, joint_visibility, true_joints_mm
from eval.scores.joint_visibility import VISIBILITIES
from eval.scores.joints import N_JOINTS


def measured(network: OnnxNetwork, frames: LabelledFrames) -> tuple[Float64, Float64, UInt8, UInt8]:
    """Return errors and deviations (F, 15), millimetres, and true and named visibility (F, 15), ids of
    ``VISIBILITIES``; deviations are NaN from networks without them.
    """
    rows = []
    for frame in frames:
        if TRUE_JOINTS not in frame.notes:
            continue
        camera = camera_of(frames, frame)
        pinhole = pinhole_of(frame, camera)
        state = BodyState.from_note(network.segment(frame.depth_mm, frame.on_person, pinhole).bearing)
        if state is None:
            continue
        errors_mm = np.linalg.norm(state.joints_mm(pinhole) - true_joints_mm(frame), axis=1)
        sd_mm, seen = state.joints_sd_mm(pinhole), state.joints_seen
        named = np.zeros(N_JOINTS, np.uint8) if seen is None else seen.argmax(axis=1).astype(np.uint8)
        sd_mm = np.full(N_JOINTS, np.nan) if sd_mm is None else sd_mm
        rows.append((errors_mm, sd_mm, joint_visibility(frame, camera), named))
    if not rows:
        sys.exit(
            f"{frames.path} has 0 people with joints; give weights with joints and frames with true ones"
        )
    errors_mm, sd_mm, truth, named = (np.array(column) for column in zip(*rows, strict=True))
    return errors_mm, sd_mm, truth.astype(np.uint8), named.astype(np.uint8)


def main() -> None:
    """Print one table for each dataset."""
    weights, *paths = map(Path, sys.argv[1:])
    network = OnnxNetwork(weights)
    for path in paths:
        errors_mm, sd_mm, truth, named = measured(network, open_frames(path))
        print(path, f"{len(errors_mm)} people")
        print("joints      n  mean mm  50 mm  100 mm  in 1 sd  in 2 sd  sd mm  named")
        for i, name in enumerate(VISIBILITIES):
            own, n = truth == i, int((truth == i).sum())
            error, sd = errors_mm[own], sd_mm[own]
            shares = (
                f"{np.mean(share):.3f}" for share in (error < 50, error < 100, error < sd, error < 2 * sd)
            )
            values = [f"{error.mean():.1f}", *shares, f"{sd.mean():.1f}", f"{np.mean(named[own] == i):.3f}"]
            print(f"{name:8s} {n:5d}", *(f"{value:>7s}" for value in values if n))


if __name__ == "__main__":
    main()
