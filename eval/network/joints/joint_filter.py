"""One-euro filter of a person's joints over a recording.

Source: Casiez, Roussel and Vogel 2012, "1 euro filter: a simple speed-based low-pass filter" (CHI). The
cutoff of a joint grows with the joint's speed: joints at rest are steady, moving joints lag little. A joint
lags by 1 / (2 pi f) seconds with a cutoff of f Hz.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from annotate.array_types import Float64
from annotate.frame_labels import FrameLabels
from annotate.segmentation.segmented_person import Segmentation
from eval.network.body_state import BodyState
from eval.network.side_smoothing import earlier_note
from eval.scores.joints import N_JOINTS
from sensors.rig.camera import Intrinsics

# Cutoffs: least mean error of recorded motion with a network's noise, at rest within 4 mm of tremble.
REST_HZ = 0.5  # cutoff of a joint at rest: lag 0.3 s
HZ_PER_M_S = 6.0  # growth of the cutoff by the joint's speed: lag 17 ms at 1 m/s and 30 frames a second
SPEED_HZ = 1.0  # cutoff of the speed, as in the source
POSTURE_S = 0.5  # decay of the earlier posture: sitting down takes one to two seconds
USUAL_S = 1 / 30  # between images without times
LONGEST_S = 0.3  # after a longer gap the joints start anew, because an arm swings in half a second


def filter_joints(
    labelled: Segmentation,
    before: FrameLabels | None,
    camera: Intrinsics,
    stamp_ns: int | None = None,
    number: int = 1,
) -> Segmentation:
    """Return a person's labels with joints and posture filtered over the recording, and the joints' facing.

    before: labels of the previous frame. camera: the undistorted depth camera. stamp_ns: time of the frame,
    None = ``USUAL_S`` after the previous one. number: person id. The note ``bearing`` gets ``filter``: the
    time, and the joints' filtered speeds (15, 3) in mm/s. Filtering starts anew after a gap, after a lost
    track, and for a person in another place.
    """
    state = BodyState.from_note(labelled.bearing)
    if state is None or labelled.bearing is None:
        return labelled
    speeds = np.zeros((N_JOINTS, 3))
    note = earlier_note(labelled, before, number)
    earlier = BodyState.from_note(note)
    if note is not None and earlier is not None:
        last_ns, last_speeds = _moving(note)
        seconds = USUAL_S if stamp_ns is None or last_ns is None else (stamp_ns - last_ns) * 1e-9
        if 0 < seconds <= LONGEST_S:
            places = earlier.joints_mm(camera), state.joints_mm(camera)
            new = np.float32(1 - np.exp(-seconds / POSTURE_S))
            joints_mm, speeds = one_euro(*places, last_speeds, seconds)
            state = state.placed(joints_mm, camera).faced_by_joints(camera)
            state = replace(state, posture=earlier.posture + (state.posture - earlier.posture) * new)
    kept = {"stamp_ns": stamp_ns, "mm_per_s": np.rint(speeds).astype(int).tolist()}
    return replace(labelled, bearing=labelled.bearing | state.note() | {"filter": kept})


def one_euro(
    last_mm: Float64, measured_mm: Float64, last_speeds: Float64, seconds: float
) -> tuple[Float64, Float64]:
    """Return filtered joints and speeds from the last filtered ones and measured joints.

    All (15, 3), millimetres and mm/s. seconds: since the last joints.
    """
    moved = (measured_mm - last_mm) / seconds
    speeds = last_speeds + _share(np.array(SPEED_HZ), seconds) * (moved - last_speeds)
    cutoffs_hz = REST_HZ + HZ_PER_M_S * np.linalg.norm(speeds, axis=-1, keepdims=True) / 1000
    return last_mm + _share(cutoffs_hz, seconds) * (measured_mm - last_mm), speeds


def _share(cutoffs_hz: Float64, seconds: float) -> Float64:
    """Return the weight of a measurement in a first-order low-pass filter."""
    return np.asarray(1 / (1 + 1 / (2 * np.pi * cutoffs_hz * seconds)))


def _moving(note: dict[str, Any]) -> tuple[int | None, Float64]:
    """Return time and speeds (15, 3) of a note's filter; None and 0 for a missing or malformed one."""
    try:
        kept = note["filter"]
        speeds = np.array(kept["mm_per_s"], np.float64)
        stamp_ns = None if kept["stamp_ns"] is None else int(kept["stamp_ns"])
    except (TypeError, KeyError, ValueError, OverflowError):
        return None, np.zeros((N_JOINTS, 3))
    if speeds.shape != (N_JOINTS, 3) or not np.isfinite(speeds).all():
        return None, np.zeros((N_JOINTS, 3))
    return stamp_ns, speeds
