"""Constants of joints and skeleton_fit, fitted: python -m tools.fit.joints DATASET ... [EVERY].

On training sets only, e.g. sitting-train and recumbent of seed 0; every EVERYth image is taken (default 13).
"""

import sys
from itertools import islice
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from annotate.labelset.dataset import Dataset
from eval.scores.joint_errors import observe
from eval.scores.joints import HINGES, JOINT, LIMBS, pushed
from eval.scores.skeleton_fit import BONES
from sensors.calibration_files.kinect2_factory import KINECT2_PINHOLE

AXES_3 = 2.37
"""Median of a chi-squared of three degrees of freedom: the squared median distance over it is a variance."""


def sigma(off_mm):
    """Robust standard deviation per axis of offsets (n, 3)."""
    return float(np.sqrt(np.median(np.square(off_mm).sum(axis=1)) / AXES_3))


def fit_hinge(surface, joint):
    """(push_mm, sigma_mm) of surface points (n, 3) before joints (n, 3)."""
    ray = surface / np.linalg.norm(surface, axis=1, keepdims=True)
    push = float(np.median(((joint - surface) * ray).sum(axis=1)))
    return push, sigma(pushed(surface, push) - joint)


def fit_limb(surface, a, b):
    """(share, push_mm, sigma_mm) of parts' middles (n, 3) along lines from a to b."""

    def off(share, push_mm):
        return pushed(surface, push_mm) - (1 - share) * a - share * b

    best = least_squares(lambda x: off(*x).ravel() / 50, (0.5, 50.0), loss="soft_l1").x
    return float(best[0]), float(best[1]), sigma(off(*best))


def main(paths, every):
    """Print what HINGES, LIMBS, BONES and HIDDEN should say."""
    seen = [
        observe(frame, frame, KINECT2_PINHOLE)
        for path in paths
        for frame in islice(Dataset.open(path), 0, None, every)
    ]
    joints, evidence = np.array(seen)["truth_mm"], np.array(seen)["evidence"]
    borders, middles, direct = (evidence[name] for name in ("borders", "middles", "direct"))
    print(f"{len(seen)} frames")
    for i, hinge in enumerate(HINGES):
        there, joint = np.isfinite(borders[:, i, 0]), joints[:, JOINT[hinge.joint]]
        on = there & direct[:, i]
        push, spread = fit_hinge(borders[on, i], joint[on])
        hidden = there & ~on
        ratio = (
            sigma(pushed(borders[hidden, i], push) - joint[hidden]) / spread if hidden.sum() > 9 else np.nan
        )
        print(f"{hinge.joint}: push {push:.0f}, sigma {spread:.0f}; hidden {ratio:.1f} times that")
    for i, limb in enumerate(LIMBS):
        there = np.isfinite(middles[:, i, 0])
        a, b = (joints[there, JOINT[name]] for name in limb.joints)
        share, push, spread = fit_limb(middles[there, i], a, b)
        print(f"{limb.part}: share {share:.2f}, push {push:.0f}, sigma {spread:.0f}")
    for a, b, _ in BONES:
        lengths = np.linalg.norm(joints[:, JOINT[a]] - joints[:, JOINT[b]], axis=1)
        print(f"{a} to {b}: {lengths.mean():.0f} +- {lengths.std():.0f}")


if __name__ == "__main__":
    step = int(sys.argv.pop()) if sys.argv[-1].isdigit() else 13
    main([Path(name) for name in sys.argv[1:]], step)
