"""The solver over whole real trials, seconds a frame; beside it SciPy's least squares on one frame."""

import time

import numpy as np
from scipy.optimize import least_squares

from synth.body.skeleton import N_JOINTS
from synth.markers.kinematics import State, markers_at
from synth.markers.person_fit import Template
from synth.markers.posture_fit import MARKER_SIGMA_M
from synth.markers.solve import solve
from synth.motion_files.marker_files import read_markers
from tests.conftest import SHARED_DATA
from tests.helpers.marker_truth import plug_in_gait, synthesise

TRIALS = (
    ("pycgm_Movement_trial.c3d", "pycgm_Static_trial.c3d"),
    ("STS1.trc", "static1.trc"),
    ("nim_cmu_02_05.c3d", None),
    ("nim_squat.c3d", None),
    ("ktk_kinematics_tennis_serve.c3d", None),
)


def bench() -> list[tuple[str, float, float]]:
    """Return rows (trial, processor seconds a frame, the same of the naive way) of the trials on disk."""
    truth = synthesise(0, 60)
    solve(truth.moving, truth.static)  # compiles
    naive, rows = naive_seconds(), []
    folder = SHARED_DATA / "mocap"
    for name, static in TRIALS if folder.is_dir() else ():
        markers, standing = read_markers(folder / name), read_markers(folder / static) if static else None
        started = time.process_time()
        motion = solve(markers, standing)
        seconds = (time.process_time() - started) / len(motion)
        report = motion.report
        rows.append(
            (f"solve {name}: median {report.median_mm:.1f}, rms {report.rms_mm:.1f} mm", seconds, naive)
        )
    return rows


def naive_seconds() -> float:
    """Return the processor seconds of SciPy's least squares with numeric derivatives on one frame."""
    markerset = plug_in_gait()
    template = Template.of(markerset)
    subject = template.subject(template.shape(1.0))
    goal = markers_at(State.of(np.full((N_JOINTS, 3), 0.1), np.zeros(3)), subject)

    def residuals(x: np.ndarray) -> np.ndarray:
        state = State.of(x[3:].reshape(N_JOINTS, 3), x[:3])
        misfit = (markers_at(state, subject) - goal).ravel() / MARKER_SIGMA_M
        return np.concatenate([misfit, 0.1 * x])

    started = time.process_time()
    least_squares(residuals, np.zeros(3 + 3 * N_JOINTS))
    return time.process_time() - started
