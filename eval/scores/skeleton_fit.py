"""One skeleton a frame from what its parts show, with bones as long in all frames of a person.

Unknown are the joints' places; known, each with its uncertainty, where parts border on each other, where
their middles lie, and how long bones are. Least squares by Gauss-Newton with Cauchy weights, so that a part
in the wrong place does not drag the rest along; many frames at once.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from annotate.array_types import Bool, Float64
from eval.scores.counts import blocks
from eval.scores.joints import HINGES, JOINT, LIMBS, N_JOINTS, Evidence, Hinge, Limb, pushed

_LIMB_BONES = (
    ("shoulder", "elbow", 260),
    ("elbow", "wrist", 226),
    ("hip", "knee", 379),
    ("knee", "ankle", 426),
)
BONES = (
    ("neck", "head", 113),
    ("neck", "pelvis", 522),
    ("left_shoulder", "right_shoulder", 340),
    ("left_hip", "right_hip", 206),
    *((f"{side}_{a}", f"{side}_{b}", mm) for side in ("left", "right") for a, b, mm in _LIMB_BONES),
    *(("neck", f"{side}_shoulder", 192) for side in ("left", "right")),
)
"""Joints and usual length in millimetres: means over the paper's eight bodies (tools/fit/joints.py)."""
FREE_MM, KNOWN_MM = 40.0, 9.0
"""Standard deviation of a bone's length before and after this person's bones are known; chosen by eye."""
TRUST_FRAMES = 30.0
"""Frames after which a person's own bone counts as much as scale times usual length; chosen by eye."""
HIDDEN = 2.8
"""Uncertainty of a border that is hidden, over that of one that is seen (tools/fit/joints.py)."""
MIDDLE_MM = 13.0
"""Standard deviation of the pelvis about the middle of the hips; chosen by eye."""
CAUCHY = 3.0
"""Standard deviations at which a term loses half of its weight; chosen by eye."""
ROUNDS = 8
"""Rounds of Gauss-Newton: the last moves joints by less than a millimetre; chosen by eye."""
LOOSE = 1e-8
"""Weight, 1/mm2, of a joint that nothing else determines: a standard deviation of 10 m; chosen by eye."""


_ENDS = np.array([(JOINT[a], JOINT[b]) for a, b, _ in BONES])
_USUAL_MM = np.array([float(mm) for _, _, mm in BONES])
_SIDE = {"left": "right", "right": "left"}


def _twin(joint: str) -> str:
    side, _, kind = joint.partition("_")
    return f"{_SIDE[side]}_{kind}" if side in _SIDE else joint


_NAMED = [{a, b} for a, b, _ in BONES]
_TWIN = np.array([_NAMED.index(set(map(_twin, ends))) for ends in _NAMED])
"""The bone on the other side, as long; a middle one is its own."""


_MEASURED: tuple[Hinge | Limb, ...] = (*HINGES, *LIMBS)


def _rows() -> tuple[Float64, Float64]:
    """Design matrix (K, 15) of the linear terms and their standard deviations (K,), millimetres per axis."""
    rows = np.zeros((len(HINGES) + len(LIMBS) + 1, N_JOINTS))
    for row, hinge in zip(rows, HINGES, strict=False):
        row[JOINT[hinge.joint]] = 1
    for row, limb in zip(rows[len(HINGES) :], LIMBS, strict=False):
        row[[JOINT[name] for name in limb.joints]] = 1 - limb.share, limb.share
    rows[-1, [JOINT[name] for name in ("left_hip", "right_hip", "pelvis")]] = 0.5, 0.5, -1
    return rows, np.array([term.sigma_mm for term in _MEASURED] + [MIDDLE_MM])


_ROWS, _SIGMA_MM = _rows()
_PUSH_MM = np.array([term.push_mm for term in _MEASURED])


class _Terms(NamedTuple):
    """``_ROWS @ joints`` should be ``values`` (F, K, 3); ``weights`` (F, K) in 1/mm2, 0 where unknown."""

    values: Float64
    weights: Float64


def fit_skeletons(evidence: Evidence, persons: Sequence[str]) -> Float64:
    """Joints (F, 15, 3) by JOINT_NAMES from EVIDENCE (F,), depth camera's frame, millimetres.

    persons: who is seen in each frame; frames of one person share the lengths of bones, left and right
    alike. NaN where the parts do not determine a joint.
    """
    joints = np.empty((len(persons), N_JOINTS, 3))
    ratio = np.empty((len(persons), len(BONES)))
    for rows in blocks(len(persons)):
        frames = evidence[rows]
        joints[rows] = _solve(_terms(frames), _USUAL_MM, FREE_MM)
        ratio[rows] = _ratio(joints[rows], _known(frames))
    people, person = np.unique(np.array(persons), return_inverse=True)
    lengths = np.array([_lengths(ratio[person == i]) for i in range(len(people))])
    for rows in blocks(len(persons)):
        frames = evidence[rows]
        fitted = _solve(_terms(frames), lengths[person[rows]], KNOWN_MM, joints[rows])
        joints[rows] = np.where(_known(frames)[..., None], fitted, np.nan)
    return joints


def _terms(evidence: Evidence) -> _Terms:
    surface = np.concatenate([evidence["borders"], evidence["middles"]], axis=1)
    middle = np.zeros((len(surface), 1, 3))
    values = np.concatenate([pushed(surface, _PUSH_MM), middle], axis=1)
    sigma = np.tile(_SIGMA_MM, (len(surface), 1))
    sigma[:, : len(HINGES)] *= np.where(evidence["direct"], 1, HIDDEN)
    there = np.isfinite(values).all(axis=-1)
    return _Terms(np.where(there[..., None], values, 0), there / sigma**2)


def _known(evidence: Evidence) -> Bool:
    """Joints (F, 15) that are determined: by a border, or along a limb from a known end, or by the hips."""
    known = np.zeros((len(evidence["borders"]), N_JOINTS), np.bool_)
    for i, hinge in enumerate(HINGES):
        known[:, JOINT[hinge.joint]] = np.isfinite(evidence["borders"][:, i, 0])
    seen = np.isfinite(evidence["middles"][..., 0])
    left, right, pelvis = (JOINT[name] for name in ("left_hip", "right_hip", "pelvis"))
    for _ in range(3):
        known[:, pelvis] |= known[:, left] & known[:, right]
        known[:, left] |= known[:, pelvis] & known[:, right]
        known[:, right] |= known[:, pelvis] & known[:, left]
        for i, limb in enumerate(LIMBS):
            a, b = (JOINT[name] for name in limb.joints)
            known[:, a] |= seen[:, i] & known[:, b]
            known[:, b] |= seen[:, i] & known[:, a]
    return known


def _ratio(joints_mm: Float64, known: Bool) -> Float64:
    """Lengths of bones over the usual ones (F, bones), by joints (F, 15, 3); NaN where an end is unknown."""
    a, b = _ENDS.T
    ratio: Float64 = np.linalg.norm(joints_mm[:, a] - joints_mm[:, b], axis=-1) / _USUAL_MM
    ratio[~(known[:, a] & known[:, b])] = np.nan
    return ratio


def _lengths(ratio: Float64) -> Float64:
    """Lengths (bones,) of a person's bones from the ratios of a loose fit of their frames (n, bones)."""
    both = np.concatenate([ratio, ratio[:, _TWIN]])
    frames = np.isfinite(both).sum(axis=0) / 2
    scale = float(np.nanmedian(ratio)) if np.isfinite(ratio).any() else 1.0
    seen = np.isfinite(both)
    own = np.array([np.median(both[seen[:, k], k]) if seen[:, k].any() else scale for k in range(len(_TWIN))])
    lengths: Float64 = _USUAL_MM * (own * frames + scale * TRUST_FRAMES) / (frames + TRUST_FRAMES)
    return lengths


def _solve(terms: _Terms, lengths_mm: Float64, sigma_mm: float, start: Float64 | None = None) -> Float64:
    """Joints (F, 15, 3) that fit linear terms and bone lengths (F, bones) or (bones,) best."""
    joints = start if start is not None else _linear(terms)
    size = N_JOINTS * 3
    for _ in range(ROUNDS):
        normal = np.zeros((len(joints), N_JOINTS, 3, N_JOINTS, 3))
        right = np.zeros(joints.shape)
        _add_linear(normal, right, terms, joints)
        _add_bones(normal, right, lengths_mm, sigma_mm, joints)
        step = np.linalg.solve(normal.reshape(-1, size, size), right.reshape(-1, size, 1))
        joints = joints + step.reshape(joints.shape)
    return joints


def _linear(terms: _Terms) -> Float64:
    """Joints (F, 15, 3) by the linear terms alone; what they leave open stays near the body's middle."""
    middle = np.median(terms.values[:, len(HINGES) : -1], axis=1, keepdims=True)
    right = _ROWS.T @ (terms.weights[..., None] * terms.values) + LOOSE * middle
    return np.asarray(np.linalg.solve(_squared(terms.weights), right))


def _squared(weights: Float64) -> Float64:
    """Normal matrices (F, 15, 15) of the linear terms with weights (F, K), of full rank."""
    return np.asarray(_ROWS.T @ (weights[..., None] * _ROWS) + LOOSE * np.eye(N_JOINTS))


def _add_linear(normal: Float64, right: Float64, terms: _Terms, joints: Float64) -> None:
    off = terms.values - _ROWS @ joints
    weights = terms.weights / (1 + terms.weights * np.square(off).sum(axis=-1) / (3 * CAUCHY**2))
    # A joint that nothing determines stays where it is.
    squared = _squared(weights)
    for axis in range(3):
        normal[:, :, axis, :, axis] += squared
    right += _ROWS.T @ (weights[..., None] * off)


def _add_bones(
    normal: Float64, right: Float64, lengths_mm: Float64, sigma_mm: float, joints: Float64
) -> None:
    bone = joints[:, _ENDS[:, 0]] - joints[:, _ENDS[:, 1]]
    length = np.maximum(np.linalg.norm(bone, axis=-1), 1e-6)
    along = bone / length[..., None]
    short = lengths_mm - length
    weight = 1 / (sigma_mm**2 + np.square(short / CAUCHY))
    stiff = weight[..., None, None] * along[..., :, None] * along[..., None, :]
    pull = (weight * short)[..., None] * along
    for k, (a, b) in enumerate(_ENDS):
        normal[:, a, :, a] += stiff[:, k]
        normal[:, b, :, b] += stiff[:, k]
        normal[:, a, :, b] -= stiff[:, k]
        normal[:, b, :, a] -= stiff[:, k]
        right[:, a] += pull[:, k]
        right[:, b] -= pull[:, k]
