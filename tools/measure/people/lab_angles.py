"""Joint angles beside a laboratory's: ``python -m tools.measure.people.lab_angles TRIAL.c3d STATIC.c3d``.

TRIAL holds the segments and angles that Plug-in-Gait computed. Prints degrees RMS after a constant offset,
flexion at hip, knee and ankle: of the solved angles as they are, and of the angles by Plug-in-Gait's own
formulas of the markers as they sit on the solved body (the laboratory's definition of axes and joint centres,
this project's motion).
"""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

from annotate.array_types import Float64
from synth.body.skeleton import JOINT_ID
from synth.markers.kinematics import State, markers_at
from synth.markers.solve import fit_person, solve
from synth.motion_files.marker_files import Markers, read_markers

LEG = ("Hip", "Knee", "Ankle")


class PlugInGait:
    """One leg's model (Davis et al. 1991; Kadaba et al. 1990), its constants read off a laboratory's outputs.

    side: "L" or "R". Joint centres follow from a marker, the joint above and a wand marker by a right angle
    at a fixed distance ("chord").
    """

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
        # What the static trial says of the shoe: a constant turn of the foot.
        u, _, v = np.linalg.svd(foot.mean(axis=0))
        self.shoe = u @ v

    def segments(self, at: dict[str, Float64]) -> list[Float64]:
        """Axes (F, 3, 3) of pelvis, thigh, shank, foot: columns forwards, left, up. at: places of markers."""
        side, sign = self.side, 1 if self.side == "L" else -1
        pelvis, origin = _pelvis(at)
        hip = origin + pelvis @ self.hip
        knee = _chord(hip, at[f"{side}KNE"], at[f"{side}THI"], self.radii[0])
        ankle = _chord(knee, at[f"{side}ANK"], at[f"{side}TIB"], self.radii[1])
        shank = _axes(knee - ankle, sign * (at[f"{side}ANK"] - ankle))
        foot = _axes(ankle - at[f"{side}TOE"], shank[..., 1])
        return [pelvis, _axes(hip - knee, sign * (at[f"{side}KNE"] - knee)), shank, foot]

    def flexion_deg(self, at: dict[str, Float64]) -> Float64:
        """Flexion (F, 3) at hip, knee and ankle, degrees (Grood & Suntay 1983): hip and ankle as recorded."""
        *upper, foot = self.segments(at)
        segments = [*upper, foot @ self.shoe]
        turns = [np.einsum("fji,fjk->fik", a, b) for a, b in pairwise(segments)]
        first = [np.unwrap(np.arctan2(turn[:, 0, 2], turn[:, 2, 2])) for turn in turns]
        return np.degrees(first).T * (-1, 1, -1)


def columns(labels: tuple[str, ...], positions: Float64) -> dict[str, Float64]:
    """Places (F, 3) by label, of (F, M, 3)."""
    return {label: positions[:, i] for i, label in enumerate(labels)}


def _unit(vectors: Float64) -> Float64:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _axes(up: Float64, left: Float64) -> Float64:
    """Axes (F, 3, 3) of an exact way up and one to the left that need not be square to it."""
    up = _unit(up)
    ahead = _unit(np.cross(left, up))
    return np.stack([ahead, np.cross(up, ahead), up], axis=-1)


def _pelvis(at: dict[str, Float64]) -> tuple[Float64, Float64]:
    """Axes (F, 3, 3) of the pelvis and the middle (F, 3) of its front."""
    front, back = (at["LASI"] + at["RASI"]) / 2, (at["LPSI"] + at["RPSI"]) / 2
    left = _unit(at["LASI"] - at["RASI"])
    return _axes(np.cross(front - back, left), left), front


def _chord(above: Float64, marker: Float64, wand: Float64, radius: float) -> Float64:
    """Joint centres (F, 3) at a radius from a marker, where the joint above and it are seen at a right angle,
    in the plane of the three, away from the wand."""
    line = above - marker
    length = np.linalg.norm(line, axis=-1, keepdims=True)
    along = _unit(line)
    off = wand - marker
    inwards = -_unit(off - (off * along).sum(axis=-1, keepdims=True) * along)
    share = radius**2 / length
    return np.asarray(marker + share * along + np.sqrt(radius**2 - share**2) * inwards)


def _recorded(at: dict[str, Float64], segment: str) -> Float64:
    """Axes (F, 3, 3) of a segment that the laboratory's software wrote."""
    return np.stack([_unit(at[segment + end] - at[segment + "O"]) for end in "ALP"], axis=-1)


def errors_deg(trial: Markers, static: Markers) -> dict[str, tuple[Float64, Float64]]:
    """Degrees RMS (3,) after a constant offset at hip, knee, ankle by side: of the solved angles as they are,
    and by Plug-in-Gait's formulas."""
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


def main(trial: Path, static: Path) -> None:
    for side, (plain, formula) in errors_deg(read_markers(trial), read_markers(static)).items():
        for joint, as_is, by_formula in zip(LEG, plain, formula, strict=True):
            print(f"{side} {joint.lower()}: {as_is:.2f} as it is, {by_formula:.2f} by the formulas")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
