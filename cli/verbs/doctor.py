"""The verb ``doctor``: what is installed, what is missing, and how to install it."""

import os
import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING

from cli.console import Json, finish
from cli.extras import COSTS
from sensors.device.address import KINDS
from sensors.errors import CloudError

if TYPE_CHECKING:
    from packaging.requirements import Requirement

NEEDED = ("packages", "PCL")
"""Findings without which labelling does not work."""


@dataclass(frozen=True)
class Finding:
    """One part of the installation. cost: what does not work without it; remedy: how to install it."""

    name: str
    ok: bool
    found: str
    cost: str = ""
    remedy: str = ""


def doctor(json: Json = False) -> None:
    """Show what is installed, what is missing, what does not work without it, and how to install it."""
    machine = f"Python {platform.python_version()}, {platform.machine()}, {os.cpu_count()} processors"
    findings = [Finding("machine", True, machine), *_extras(), _pcl(), _kinect2(), _screen()]
    width = max(len(one.name) for one in findings)
    lines = []
    for one in findings:
        lines.append(f"{'ok     ' if one.ok else 'missing'}  {one.name:<{width}}  {one.found}")
        if not one.ok:
            lines.append(f"{'':9}{'':{width}}  {one.cost}; {one.remedy}")
    answer = {
        "ok": all(one.ok for one in findings if one.name in NEEDED),
        "findings": [asdict(one) for one in findings],
    }
    finish(answer, json, "\n".join(lines))


def _extras() -> list[Finding]:
    # Here, since every command imports this module.
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
    """What is wrong with a package; "" if nothing is."""
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
    """Whether a check passes; else what its error says, and the remedy after the semicolon."""
    try:
        check()
    except CloudError as error:
        why, remedy = str(error).split("; ", 1)
        return Finding(name, False, why, cost, remedy)
    return Finding(name, True, found)
