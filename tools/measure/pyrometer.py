"""What a pyrometer is worth: ``python -m tools.measure.pyrometer [RECORDINGS] [FIRST_SEED] [FRAMES]``.

Recordings of two people at `hard`, whose thermal camera drifts by up to 2 K. Printed are, with and without
the pyrometer's corrections, how far a person's temperature is off, and the IoU of the person: found with the
temperatures that each frame suggests, as ``label`` does, and with fixed ones, as ``label --window``.
"""

import sys
from dataclasses import replace

import numpy as np

from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.person.extract import PersonDetection
from annotate.person.warmth import WINDOW_C
from annotate.suit.palette import DEFAULT_SUIT
from sensors.rig.frame import RigFrame
from sensors.rig.thermal_reference import ThermalReference
from synth.rig.truth import Truth, truth_labels
from synth.rig.virtual_rig import RigOptions, VirtualRig

WINDOWS = {"found": None, "fixed": WINDOW_C}


def corrections_k(pairs: list[tuple[RigFrame, Truth]], focal_px: float) -> np.ndarray:
    """What the pyrometer adds to every frame; nothing where it cannot be told what it points at."""
    reference = ThermalReference(focal_px)
    for frame, truth in pairs:
        if frame.thermal_c is not None:
            reference.add(frame.stamp_ns * 1e-9, truth.spot_c, frame.thermal_c)
    spot, times_s = reference.spot(), np.array([frame.stamp_ns * 1e-9 for frame, _ in pairs])
    return np.zeros(len(pairs)) if spot is None else reference.offsets_k(spot, times_s)


def iou(fuser: Fuser, frame: RigFrame, truth: np.ndarray, window_c: tuple[float, float] | None) -> float:
    """Of the person found in one frame alone, by warmth and suit."""
    mask = PersonDetection(CoarseCloud.of(fuser.fuse_frame(frame)), window_c, DEFAULT_SUIT).person().mask
    return float((mask & truth).sum() / max(1, (mask | truth).sum()))


def measure(seed: int, frames: int) -> tuple[list[list[float]], list[list[float]]]:
    """By frame: error of temperatures without and with, kelvin; IoU by window, without and with."""
    rig = VirtualRig(frames, 2, "hard", seed, RigOptions(pyrometer=True))
    pairs, fuser, off, ious = list(rig.with_truth()), Fuser(rig.calibration), [], []
    for (frame, truth), more_k in zip(pairs, corrections_k(pairs, rig.calibration.thermal.fx), strict=True):
        off.append([abs(truth.drift_c), abs(truth.drift_c + more_k)])
        if frame.thermal_c is not None:
            person = truth_labels(frame, truth, rig.calibration.depth).persons == 1
            better = replace(frame, thermal_c=frame.thermal_c + np.float32(more_k))
            ious.append([iou(fuser, f, person, w) for w in WINDOWS.values() for f in (frame, better)])
    return off, ious


def main(recordings: int, first_seed: int, frames: int) -> None:
    off, ious = [], []
    for seed in range(first_seed, first_seed + recordings):
        one = measure(seed, frames)
        off += one[0]
        ious += one[1]
        print(
            f"seed {seed}: off by {np.median(one[0], axis=0).round(2)} K without and with; IoU with "
            f"temperatures found {np.mean(one[1], axis=0)[:2].round(4)}, fixed "
            f"{np.mean(one[1], axis=0)[2:].round(4)}",
            flush=True,
        )
    medians, worst = np.median(off, axis=0), np.quantile(off, 0.95, axis=0)
    print(f"{len(off)} frames: median {medians.round(2)} K, 95 % within {worst.round(2)} K")
    print("IoU, found without, with; fixed without, with:", np.mean(ious, axis=0).round(4))


if __name__ == "__main__":
    recordings, first_seed, frames = map(int, (*sys.argv[1:], *("6", "7101", "40")[len(sys.argv) - 1 :]))
    main(recordings, first_seed, frames)
