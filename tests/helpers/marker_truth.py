"""Markers synthesised from known angles: the truth that the solver is measured against."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from synth.body.body import shipped_bodies
from synth.body.skeleton import JOINT_ID, LIMITS_RAD, N_JOINTS, rotations
from synth.markers.kinematics import State, Subject, markers_at
from synth.markers.person_fit import zero_bones
from synth.motion_files.marker_files import Markers
from synth.motion_files.marker_set import MarkerSet, shipped_marker_sets
from synth.motion_files.vertical_axis import Upward

RATE = 100.0


def plug_in_gait() -> MarkerSet:
    return next(s for s in shipped_marker_sets() if s.name == "plug_in_gait")


def worn(
    places: MarkerSet, angles_rad: np.ndarray, pelvis_m: np.ndarray, scale: float = 1.0, body: int = 7
) -> np.ndarray:
    """Return the markers (F, M, 3) of a set on a body in postures (F, J, 3), pelvis (3,) or (F, 3)."""
    subject = Subject(zero_bones(shipped_bodies()[body].joints_m), places.joint, scale * places.at_m)
    pelvis = np.broadcast_to(pelvis_m, (len(angles_rad), 3)).copy()
    return np.array([markers_at(State.of(a, p), subject) for a, p in zip(angles_rad, pelvis, strict=True)])


@dataclass(frozen=True)
class Truth:
    """A person of known bones and marker places, standing and moving; angles (F, J, 3), pelvis (F, 3)."""

    angles_rad: np.ndarray
    pelvis_m: np.ndarray
    static: Markers
    moving: Markers


def synthesise(
    seed: int, frames: int, noise_mm: float = 2.0, body: int = 7, misplaced_mm: float = 8.0
) -> Truth:
    """Smooth random motion of a body that is not the solver's reference, markers 8 mm off their places."""
    rng = np.random.default_rng(seed)
    markerset = plug_in_gait()
    scale = shipped_bodies()[body].height_cm / 170
    offsets = scale * markerset.at_m + rng.normal(0, misplaced_mm / 1000, markerset.at_m.shape)

    def recorded(angles: np.ndarray, pelvis: np.ndarray) -> Markers:
        noisy = worn(replace(markerset, at_m=offsets), angles, pelvis, body=body) + rng.normal(
            0, noise_mm / 1000, (len(angles), len(offsets), 3)
        )
        return Markers(markerset.names, 1000 * noisy, RATE, "mm", Upward("z", "the test"))

    standing = np.zeros((40, N_JOINTS, 3))
    for side in ("left", "right"):
        standing[:, JOINT_ID[f"{side}_shoulder"], 1] = np.radians(25)
        standing[:, JOINT_ID[f"{side}_elbow"], 0] = np.radians(15)
    angles, pelvis = _motion(rng, frames)
    still = np.tile([0.0, 0.0, 0.95 * scale], (40, 1))
    return Truth(angles, pelvis, recorded(standing, still), recorded(angles, pelvis))


def _motion(rng: np.random.Generator, frames: int) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(frames) / RATE
    middle, reach = LIMITS_RAD.mean(axis=2), np.ptp(LIMITS_RAD, axis=2) / 2
    middle[0], reach[0] = 0, np.radians([25, 20, 60])
    # Toes and twisted spines are the same movement to these markers when every joint strays at random.
    waves = np.sin(
        2 * np.pi * (rng.uniform(0.1, 0.6, (N_JOINTS, 3)) * time[:, None, None] + rng.random((N_JOINTS, 3)))
    )
    angles = middle + 0.5 * reach * waves
    spine = [JOINT_ID[f"spine_{part}"] for part in ("lower", "middle", "upper")]
    neck = [JOINT_ID["neck"], JOINT_ID["head"]]
    for shared in (spine, neck):
        angles[:, shared] = angles[:, shared[:1]]
    path = np.stack([0.3 * np.sin(time), 0.3 * np.cos(0.7 * time), 0.9 + 0.1 * np.sin(1.3 * time)], axis=1)
    return angles, path


def joint_errors_deg(truth: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Angle of the rotation between true and found joint rotations, degrees (F, J)."""
    turns = [
        Rotation.from_matrix(np.swapaxes(rotations(a), 1, 2) @ rotations(b)).magnitude()
        for a, b in zip(truth, found, strict=True)
    ]
    return np.degrees(np.array(turns))
