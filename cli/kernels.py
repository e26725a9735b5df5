"""The verb ``compile``: kernels are compiled now rather than while a verb that needs them waits."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from cli.console import Json, finish, progress
from cli.extras import needing

IMAGES = 24
"""Images of the drawn preset that are made; with fewer, some kind of sensor or garment is missing."""


def compile_(json: Json = False) -> None:
    """Compile the numerical kernels once, so that no verb has to wait for the compiler later."""
    with needing("synth"):
        from synth.images.workers import processes
    started = time.monotonic()
    with processes(2) as (pool, _), progress("compile", len(WORK)) as advance:
        for future in [pool.submit(work) for work in WORK]:
            future.result()
            advance(1)
    seconds = round(time.monotonic() - started, 1)
    finish({"seconds": seconds}, json, f"kernels are compiled, {seconds} s; later runs find them")


def _label() -> None:
    """A recording of the virtual rig, labelled and compared with its truth."""
    from annotate.label_recording import SuitLabeller, label_source
    from annotate.labelset.label_set import LabelSet
    from eval.compare.compare import compare_sets
    from sensors.session.reader import Session
    from synth.rig.simulate import simulate, truth_path
    from synth.rig.virtual_rig import VirtualRig

    with tempfile.TemporaryDirectory() as folder:
        path, rig = Path(folder) / "rig.mcap", VirtualRig(2, 1, "hard", 0)
        simulate(rig, path, _nothing)
        session = Session(path)
        found = label_source(session, SuitLabeller(rig.suit), Path(folder) / "labels", _nothing).labels
        compare_sets(found, LabelSet.open(truth_path(path)))


def _generate() -> None:
    """Images of each way of drawing people."""
    from concurrent.futures import ThreadPoolExecutor

    from synth.images.generate import Order, generate
    from synth.images.presets import PRESETS
    from synth.images.workers import Workers

    for name, count in (("people", IMAGES), ("sitting-train", 2), ("recumbent", 2)):
        with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(1) as pool:
            generate(Order(PRESETS[name], count, 0), Path(folder) / name, Workers(pool, 1), _nothing)


def _solve() -> None:
    """Markers of somebody who stands still."""
    import numpy as np

    from synth.body.body import shipped_bodies
    from synth.body.flesh import flesh_of
    from synth.body.skeleton import N_JOINTS
    from synth.markers.kinematics import State, Subject, markers_at
    from synth.markers.person_fit import zero_bones
    from synth.markers.solve import solve
    from synth.motion.grounded import Traces
    from synth.motion_files.marker_files import Markers
    from synth.motion_files.marker_set import shipped_marker_sets
    from synth.motion_files.vertical_axis import GIVEN, Upward

    places, bones = shipped_marker_sets()[0], zero_bones(shipped_bodies()[0].joints_m)
    state = State.of(np.zeros((N_JOINTS, 3)), np.array([0.0, 0.0, 0.95]))
    positions = 1000 * np.array([markers_at(state, Subject(bones, places.joint, places.at_m))] * 8)
    standing = Markers(places.names, positions, 100.0, "mm", Upward("z", GIVEN))
    motion = solve(standing, standing, places)
    Traces.of(flesh_of(shipped_bodies()[0]), motion.angles_rad, motion.pelvis_m)


def _nothing(count: int) -> None:
    """Progress of which nothing is shown."""


WORK: tuple[Callable[[], None], ...] = (_label, _generate, _solve)
"""What runs all kernels once; the longest first."""
