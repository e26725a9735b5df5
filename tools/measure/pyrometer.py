"""Temperatures and person detection of drifting recordings, with and without a pyrometer's corrections."""

from dataclasses import replace

import numpy as np

from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.person.extract import PersonDetection
from annotate.person.warmth import WINDOW_C
from annotate.suit.palette import Suit
from sensors.rig.frame import RigFrame
from sensors.rig.thermal_reference import ThermalReference
from synth.data_files import JUDGE
from synth.rig.truth import Truth, truth_labels
from synth.rig.virtual_rig import RigOptions, VirtualRig


def corrections_k(pairs: list[tuple[RigFrame, Truth]], focal_px: float) -> np.ndarray:
    """Return the pyrometer's correction of every frame; 0 where its spot is unknown."""
    reference = ThermalReference(focal_px)
    for frame, truth in pairs:
        if frame.thermal_c is not None:
            reference.add(frame.stamp_ns * 1e-9, truth.spot_c, frame.thermal_c)
    spot, times_s = reference.spot(), np.array([frame.stamp_ns * 1e-9 for frame, _ in pairs])
    return np.zeros(len(pairs)) if spot is None else reference.offsets_k(spot, times_s)


def detected(fuser: Fuser, frame: RigFrame, window_c: tuple[float, float] | None, suit: Suit) -> np.ndarray:
    """Return the mask of the person detected in one frame by warmth and suit."""
    return PersonDetection(CoarseCloud.of(fuser.fuse_frame(frame)), window_c, suit).person().mask


def iou(mask: np.ndarray, truth: np.ndarray) -> float:
    """Return the IoU of two masks."""
    return float((mask & truth).sum() / max(1, (mask | truth).sum()))


def measure(seed: int, frames: int) -> tuple[list[list[float]], list[list[float]]]:
    """Measure a recording of two people at `hard`, with a thermal drift of up to 2 K.

    Returns by frame: error of the temperatures without and with corrections, kelvin; IoU without and with,
    first with the temperatures that each frame suggests (as ``label``), then with fixed ones
    (``label --window``).
    """
    rig = VirtualRig(frames, 2, "hard", seed, RigOptions(pyrometer=True, cast=JUDGE))
    pairs, fuser, off, ious = list(rig.with_truth()), Fuser(rig.calibration), [], []
    for (frame, truth), more_k in zip(pairs, corrections_k(pairs, rig.calibration.thermal.fx), strict=True):
        off.append([abs(truth.drift_c), abs(truth.drift_c + more_k)])
        if frame.thermal_c is not None:
            person = truth_labels(frame, truth, rig.calibration.depth).persons == 1
            better = replace(frame, thermal_c=frame.thermal_c + np.float32(more_k))
            pairs_of = ((f, window_c) for window_c in (None, WINDOW_C) for f in (frame, better))
            ious.append([iou(detected(fuser, f, window_c, rig.suit), person) for f, window_c in pairs_of])
    return off, ious
