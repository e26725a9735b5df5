"""How well guided calibration finds a rig: ``python -m tools.measure.guided [RUNS] [FIRST_SEED] [RIG]``.

Somebody holds the virtual plate as ``guide`` asks for, within some centimetres and degrees; a tenth of the
views is bad. Printed are, of each run, the views until it says good, and the true errors then.
"""

import sys

import numpy as np
from scipy.spatial.transform import Rotation

from sensors.calibrate.guide import ENOUGH_VIEWS, PlateSetup, guide, is_new, next_placement
from sensors.calibrate.hole_plate import HolePlate
from sensors.calibrate.plate_view import view_plate
from sensors.recording.rig_templates import REFERENCE, RigTemplate, template_named
from sensors.rig.rig_calibration import Pose
from synth.rig.plate_views import PlateViews
from tools.measure.calibration import errors

HAND_M, HAND_DEG = 0.03, (5.0, 5.0, 8.0)
"""How far a hand is from what was asked for, standard deviations: place, and turn about x, y, z. By eye."""
MOST_HELD = 60


def by_hand(pose: Pose, plate: HolePlate, rng: np.random.Generator) -> Pose:
    middle = np.array([*plate.size_m.mean(axis=0), 0.0])
    turn = Rotation.from_rotvec(rng.normal(0, HAND_DEG), degrees=True).as_matrix()
    rotation = pose.rotation @ turn
    return Pose(rotation, pose.apply(middle) + rng.normal(0, HAND_M, 3) - rotation @ middle)


def run(seed: int, rig: RigTemplate) -> tuple[int, int, np.ndarray]:
    """Views used and views held until it is good, and the worst errors: degrees, lateral and axial mm."""
    rng, setup = np.random.default_rng(seed), PlateSetup.of(rig.calibration, rig.plate)
    plate, guess, source = rig.plate, rig.calibration, PlateViews(rig, 0, seed)
    views, wish = [], next_placement(())
    for held in range(MOST_HELD):
        frame = source.held(held, by_hand(setup.pose(wish), plate, rng))
        view = view_plate(frame, plate, guess.depth)
        if not is_new(view, views, setup):
            continue
        views.append(view)
        if len(views) < ENOUGH_VIEWS:
            wish = next_placement([setup.placement_of(view) for view in views])
            continue
        now = guide(views, setup)
        if now.wanted is None:
            assert now.found is not None
            off = [errors(now.found, name, rig) for name in now.found.deviations]
            worst = [(np.linalg.norm(turn), np.linalg.norm(mm[:2]), abs(mm[2])) for turn, mm in off]
            return len(views), held + 1, np.max(worst, axis=0)
        wish = now.wanted
    return len(views), MOST_HELD, np.full(3, np.nan)


def main(runs: int, first_seed: int, rig: RigTemplate) -> None:
    rows = []
    for seed in range(first_seed, first_seed + runs):
        views, held, worst = run(seed, rig)
        rows.append((views, *worst))
        print(
            f"seed {seed}: good after {views} views ({held} held): {worst[0]:.3f} deg, lateral "
            f"{worst[1]:.2f} mm, axial {worst[2]:.2f} mm",
            flush=True,
        )
    most = np.max(rows, axis=0)
    print(f"most views {most[0]:.0f}; worst {most[1]:.3f} deg, {most[2]:.2f} mm, {most[3]:.2f} mm")


if __name__ == "__main__":
    runs, first_seed, name = (*sys.argv[1:], *("20", "4000", REFERENCE)[len(sys.argv) - 1 :])
    main(int(runs), int(first_seed), template_named(name))
