"""Plug-in-Gait's joint angles, to compare with a laboratory's."""

from itertools import pairwise

import numpy as np

from annotate.array_types import Float64
from synth.body.skeleton import JOINT_ID
from synth.markers.kinematics import State, markers_at
from synth.markers.solve import fit_person, solve
from synth.motion_files.marker_files import Markers

LEG = ("Hip", "Knee", "Ankle")


class PlugInGait:
    """One leg's model (Davis et al. 1991; Kadaba et al. 1990) with constants from a laboratory's outputs."""

    def __init__(self, trial: Markers, side: str) -> None:
        at = columns(trial.labels, trial.positions)
        self.side = side
        hip, knee, ankle = at[f"{side}FEP"], at[f"{side}FEO"], at[f"{side}TIO"]
        pelvis, origin = _pelvis(at)
        self.hip = np.median(np.einsum("fji,fj->fi", pelvis, hip - origin), axis=0)
        self.radii = [
            float(np.median(np.linalg.norm(a - at[side + m], axis=1)))
            for a, m in ((knee, "KNE"), (ankle, "ANK"))
        ]
        foot = np.einsum("fji,fjk->fik", self.segments(at)[3], _recorded(at, f"{side}FO"))
        # The constant turn of the shoe in the static trial.
        u, _, v = np.linalg.svd(foot.mean(axis=0))
        self.shoe = u @ v

    def segments(self, at: dict[str, Float64]) -> list[Float64]:
        """Return axes (F, 3, 3) of pelvis, thigh, shank, foot: columns forwards, left, up."""
        side, sign = self.side, 1 if self.side == "L" else -1
        pelvis, origin = _pelvis(at)
        hip = origin + pelvis @ self.hip
        knee = _chord(hip, at[f"{side}KNE"], at[f"{side}THI"], self.radii[0])
        ankle = _chord(knee, at[f"{side}ANK"], at[f"{side}TIB"], self.radii[1])
        shank = _axes(knee - ankle, sign * (at[f"{side}ANK"] - ankle))
        foot = _axes(ankle - at[f"{side}TOE"], shank[..., 1])
        return [pelvis, _axes(hip - knee, sign * (at[f"{side}KNE"] - knee)), shank, foot]

    def flexion_deg(self, at: dict[str, Float64]) -> Float64:
        """Return the flexion (F, 3) at hip, knee and ankle, degrees (Grood & Suntay 1983)."""
        *upper, foot = self.segments(at)
        segments = [*upper, foot @ self.shoe]
        turns = [np.einsum("fji,fjk->fik", a, b) for a, b in pairwise(segments)]
        first = [np.unwrap(np.arctan2(turn[:, 0, 2], turn[:, 2, 2])) for turn in turns]
        return np.degrees(first).T * (-1, 1, -1)


def columns(labels: tuple[str, ...], positions: Float64) -> dict[str, Float64]:
    """Return places (F, 3) by label, of (F, M, 3)."""
    return {label: positions[:, i] for i, label in enumerate(labels)}


def _unit(vectors: Float64) -> Float64:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _axes(up: Float64, left: Float64) -> Float64:
    """Return axes (F, 3, 3) of an exact way up and an approximate way left."""
    up = _unit(up)
    ahead = _unit(np.cross(left, up))
    return np.stack([ahead, np.cross(up, ahead), up], axis=-1)


def _pelvis(at: dict[str, Float64]) -> tuple[Float64, Float64]:
    """Return axes (F, 3, 3) of the pelvis and the middle (F, 3) of its front."""
    front, back = (at["LASI"] + at["RASI"]) / 2, (at["LPSI"] + at["RPSI"]) / 2
    left = _unit(at["LASI"] - at["RASI"])
    return _axes(np.cross(front - back, left), left), front


def _chord(above: Float64, marker: Float64, wand: Float64, radius: float) -> Float64:
    """Return joint centres (F, 3) at a radius from a marker and a right angle to the joint above."""
    line = above - marker
    length = np.linalg.norm(line, axis=-1, keepdims=True)
    along = _unit(line)
    off = wand - marker
    inwards = -_unit(off - (off * along).sum(axis=-1, keepdims=True) * along)
    share = radius**2 / length
    return np.asarray(marker + share * along + np.sqrt(radius**2 - share**2) * inwards)


def _recorded(at: dict[str, Float64], segment: str) -> Float64:
    """Return axes (F, 3, 3) of a segment from the laboratory's software."""
    return np.stack([_unit(at[segment + end] - at[segment + "O"]) for end in "ALP"], axis=-1)


def errors_deg(trial: Markers, static: Markers) -> dict[str, tuple[Float64, Float64]]:
    """Return RMS (3,) after an offset at hip, knee, ankle by side: of solved angles, and by the formulas."""
    motion, (_, person, markerset, _) = solve(trial, static), fit_person(trial, static)
    states = [State.of(a, p) for a, p in zip(motion.angles_rad, motion.pelvis_m, strict=True)]
    worn = 1000 * np.array([markers_at(state, person) for state in states])
    at, found = columns(trial.labels, trial.positions), {}
    for side, name in (("L", "left"), ("R", "right")):
        own = np.stack([at[f"{side}{joint}Angles"][:, 0] for joint in LEG], axis=1)
        joints = [JOINT_ID[f"{name}_{joint.lower()}"] for joint in LEG]
        plain = np.degrees(motion.angles_rad[:, joints, 0]) * (1, -1, 1)
        formula = PlugInGait(trial, side).flexion_deg(columns(markerset.names, worn))
        found[name] = (plain - own).std(axis=0), (formula - own).std(axis=0)
    return found
