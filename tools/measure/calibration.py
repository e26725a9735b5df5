"""Errors of ``calibrate``: ``python -m tools.measure.calibration [RUNS] [FIRST_SEED] [RIG]``.

Each run has 40 views of the virtual plate, a tenth of them bad. Prints the errors of each run beside the
stated standard deviations, and the share of errors within two deviations.
"""

import sys

import numpy as np
from scipy.spatial.transform import Rotation

from sensors.calibrate.bundle import Adjusted, adjust
from sensors.calibrate.plate_view import view_plate
from sensors.recording.rig_templates import REFERENCE, RigTemplate, template_named
from synth.rig.plate_views import PlateViews

VIEWS = 40


def errors(found: Adjusted, name: str, rig: RigTemplate) -> tuple[np.ndarray, np.ndarray]:
    """Return a pose's errors: rotation (3,) in degrees, translation (3,) in millimetres."""
    stated = getattr(found.calibration, f"{name}_from_depth")
    true = getattr(rig.calibration, f"{name}_from_depth")
    turn = Rotation.from_matrix(stated.rotation @ true.rotation.T).as_rotvec(degrees=True)
    return turn, 1000 * (stated.translation_m - true.translation_m)


def main(runs: int, first_seed: int, rig: RigTemplate) -> None:
    covered, worst = [], np.zeros(3)
    for seed in range(first_seed, first_seed + runs):
        views = [view_plate(f, rig.plate, rig.calibration.depth) for f in PlateViews(rig, VIEWS, seed)]
        found = adjust(views, rig.plate, rig.calibration)
        for name, stated in found.deviations.items():
            turn, shift = errors(found, name, rig)
            sd = np.r_[stated.rotation_deg, stated.translation_mm]
            inside = np.abs(np.r_[turn, shift]) <= 2 * sd
            covered.append(inside)
            off = np.linalg.norm(turn), np.linalg.norm(shift[:2]), abs(shift[2])
            worst = np.maximum(worst, off)
            print(
                f"seed {seed} {name}: {off[0]:.3f} deg, lateral {off[1]:.2f} mm, "
                f"axial {shift[2]:+.2f} mm (sd {sd[5]:.2f}); covered {inside.astype(int)}; "
                f"left out {len(found.left_out)}",
                flush=True,
            )
    print(f"worst: {worst[0]:.3f} deg, lateral {worst[1]:.2f} mm, axial {worst[2]:.2f} mm")
    print(f"two deviations cover the truth in {np.mean(covered):.3f} of {np.size(covered)} numbers,")
    print("by number (rotation x y z, translation x y z):", np.mean(covered, axis=0).round(3))


if __name__ == "__main__":
    runs, first_seed, name = (*sys.argv[1:], *("50", "2000", REFERENCE)[len(sys.argv) - 1 :])
    main(int(runs), int(first_seed), template_named(name))
