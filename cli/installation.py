"""Verbs on the installation: doctor, compile."""

import os
import platform
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from cli.console import Json, finish, progress
from cli.extras import COSTS, needing
from sensors.device.address import KINDS
from sensors.errors import CloudError

if TYPE_CHECKING:
    from packaging.requirements import Requirement

IMAGES = 24  # of the preset people that compile generates; fewer leave out a kind of sensor or garment
NEEDED = ("packages", "PCL")  # findings without which labelling does not work


@dataclass(frozen=True)
class Finding:
    """Part of the installation. cost: features that fail without the part; remedy: its installation."""

    name: str
    ok: bool
    found: str
    cost: str = ""
    remedy: str = ""


def doctor(json: Json = False) -> None:
    """Show installed and missing parts, the features that fail without them, and remedies."""
    machine = f"Python {platform.python_version()}, {platform.machine()}, {os.cpu_count()} processors"
    findings = [Finding("machine", True, machine), *_packages(), _pcl(), _kinect2(), _screen()]
    width = max(len(one.name) for one in findings)
    lines = []
    for one in findings:
        lines.append(f"{'ok     ' if one.ok else 'missing'}  {one.name:<{width}}  {one.found}")
        if not one.ok:
            lines.append(f"{'':9}{'':{width}}  {one.cost}; {one.remedy}")
    works = all(one.ok for one in findings if one.name in NEEDED)
    finish({"ok": works, "findings": [asdict(one) for one in findings]}, json, *lines)


def _packages() -> list[Finding]:
    """Return a finding on the base, and a finding on each extra."""
    from importlib.metadata import requires

    from packaging.requirements import Requirement

    wanted = [Requirement(line) for line in requires("annotate-cloud") or ()]
    base = _extra("", [one for one in wanted if one.marker is None])
    extras = {e: [one for one in wanted if one.marker and one.marker.evaluate({"extra": e})] for e in COSTS}
    return [base, *(_extra(extra, needed) for extra, needed in extras.items())]


def _extra(extra: str, needed: "list[Requirement]") -> Finding:
    wrong = [problem for problem in map(_problem, needed) if problem]
    name, target = (f"extra {extra}", f"annotate-cloud[{extra}]") if extra else ("packages", "annotate-cloud")
    known = f"{len(needed)} package" + "s" * (len(needed) > 1) if needed else "unknown to this installation"
    known += "".join(f"; tested with {one.tested}" for one in KINDS.values() if f"`{extra}`" in one.needs)
    ok, cost = bool(needed) and not wrong, COSTS.get(extra, "nothing works")
    return Finding(name, ok, ", ".join(wrong) or known, cost, f"pip install '{target}'")


def _problem(requirement: "Requirement") -> str:
    """Return the fault of a required package, or ""."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        found = version(requirement.name)
    except PackageNotFoundError:
        return f"no {requirement.name}"
    fits = requirement.specifier.contains(found, prereleases=True)
    return "" if fits else f"{requirement.name}{requirement.specifier} but {found}"


def _pcl() -> Finding:
    try:
        from annotate.cloud.supervoxels import supervoxels  # noqa: F401
    except ImportError as error:
        return Finding(
            "PCL", False, str(error), "no labels from a suit (label)",
            "apt install libpcl-dev, then pip install --force-reinstall --no-deps annotate-cloud",
        )  # fmt: skip
    return Finding("PCL", True, "the extension can be loaded")


def _kinect2() -> Finding:
    from sensors.drivers.kinect2 import load_shim

    found = "libfreenect2 can be used (its driver has met no camera: see devices)"
    return _tried(load_shim, "Kinect v2", found, "no Kinect v2 as a device")


def _screen() -> Finding:
    cost = "no windows (fix, live)"
    if find_spec("PySide6") is None:
        found = "not tested without the extra gui"
        return Finding("screen", False, found, cost, "pip install 'annotate-cloud[gui]'")
    from annotate.gui.display import check_screen

    return _tried(check_screen, "screen", "a window can be shown", cost)


def _tried(check: Callable[[], object], name: str, found: str, cost: str) -> Finding:
    """Run a check and return its finding; an error is split at the semicolon into fault and remedy.

    found: text if the check passes.
    """
    try:
        check()
    except CloudError as error:
        why, remedy = str(error).split("; ", 1)
        return Finding(name, False, why, cost, remedy)
    return Finding(name, True, found)


def compile_(json: Json = False) -> None:
    """Compile the numerical kernels once, so that no verb has to wait for the compiler later."""
    with needing("synth"):
        from synth.images import generate  # noqa: F401
        from synth.images.workers import processes
    started, work = time.monotonic(), (_label, _generate, _solve, _dress)  # the longest first
    with processes(2) as (pool, _), progress("compile", len(work)) as advance:
        for future in [pool.submit(each) for each in work]:
            future.result()
            advance(1)
    seconds = round(time.monotonic() - started, 1)
    finish({"seconds": seconds}, json, f"kernels are compiled, {seconds} s; later runs find them")


def _label() -> None:
    """Label a recording of the virtual rig by suit and by network and compare, to compile the kernels."""
    from annotate.label_recording import SuitLabeller, label_source
    from annotate.labelset.label_set import LabelSet
    from annotate.segmentation.suit_network import SuitNetwork
    from eval.compare.compare import compare_sets
    from eval.network.onnx_network import OnnxNetwork
    from eval.network.predict import PredictOptions
    from eval.network.predict_source import predict_source
    from eval.network.refine import SHIPPED_REFINEMENT_NETWORK
    from sensors.session.reader import Session
    from synth.rig.simulate import simulate, truth_path
    from synth.rig.virtual_rig import VirtualRig

    with tempfile.TemporaryDirectory() as folder:
        path, rig = Path(folder) / "rig.mcap", VirtualRig(2, 1, "hard", 0)
        simulate(rig, path, lambda _: None)
        labeller, out = SuitLabeller(rig.suit), Path(folder) / "labels"
        found = label_source(Session(path), labeller, out, lambda _: None).labels
        compare_sets(found, LabelSet.open(truth_path(path)))
        options = PredictOptions(refiners=[SuitNetwork(SHIPPED_REFINEMENT_NETWORK)])
        predict_source(Session(path), OnnxNetwork(), Path(folder) / "network", lambda _: None, options)


def _generate() -> None:
    """Generate images of presets with each kind of people, to compile the kernels."""
    from concurrent.futures import ThreadPoolExecutor

    from synth.images.generate import Order, generate
    from synth.images.presets import PRESETS
    from synth.images.workers import Workers

    for name, count in (("people", IMAGES), ("sitting-train", 2), ("recumbent", 2)):
        with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(1) as pool:
            generate(Order(PRESETS[name], count, 0), Path(folder) / name, Workers(pool, 1), lambda _: None)


def _solve() -> None:
    """Solve the markers of a standing person, to compile the kernels."""
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


def _dress() -> None:
    """Dress a person in a skirt, to compile the kernels."""
    import numpy as np

    from synth.body.body import shipped_bodies
    from synth.clothes.attire import draw_attire
    from synth.clothes.dress import dress_in

    rng = np.random.default_rng(0)
    while not (attire := draw_attire(rng)).skirt:
        pass
    dress_in(shipped_bodies()[0], attire, rng)
