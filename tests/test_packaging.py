"""Packages: the base labels alone, a missing extra is named, a wheel lists its libraries."""

import json
import re
import subprocess
import sys
import tomllib
from importlib.metadata import distributions, packages_distributions
from pathlib import Path

import numpy as np
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

from annotate import _pcl
from synth.rig.simulate import suit_path, truth_path
from tests.helpers.cloud_files import camera_points, ply, room
from tests.helpers.flir_files import flir_jpeg

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
ALIAS = {
    "pyk4a-bundle": "pyk4a",
    "pyorbbecsdk2": "pyorbbecsdk",
    "segmentation-models-pytorch": "segmentation_models_pytorch",
}
"""Module names of packages that may be absent."""

BASE_ONLY = """
import contextlib, io, json, sys
commands, absent = json.load(sys.stdin)
sys.modules.update(dict.fromkeys(absent))
from cli.main import main
said = []
for command in commands:
    sys.argv, err, code = ["annotate-cloud", *command], io.StringIO(), 0
    with contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
    said.append((code, err.getvalue()))
print(json.dumps(said))
"""
"""Commands in one process that cannot import the packages of the extras."""


def names_of(requirements: list[str]) -> set[str]:
    return {canonicalize_name(Requirement(line).name) for line in requirements} - {"annotate-cloud"}


def modules_of_extras() -> list[str]:
    """Return top-level modules that only extras install."""
    base = names_of(PROJECT["dependencies"])
    brought = set().union(*map(names_of, PROJECT["optional-dependencies"].values())) - base
    assert {"open3d-cpu", "pyvista", "torch", "scikit-image"} <= brought
    found = {
        module
        for module, packages in packages_distributions().items()
        if {canonicalize_name(package) for package in packages} & brought
    }
    return sorted(found | {ALIAS.get(name, name) for name in brought} - {"packaging"})


def run_with_base_only(commands: list[list[object]]) -> list[tuple[int, str]]:
    text = json.dumps(([[str(word) for word in command] for command in commands], modules_of_extras()))
    python = [sys.executable, "-c", BASE_ONLY]
    done = subprocess.run(python, input=text, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return [(code, said) for code, said in json.loads(done.stdout)]


def test_labelling_needs_no_extra(rig_session, tmp_path):
    suit, truth = suit_path(rig_session), truth_path(rig_session)
    session, labels, coco, back = rig_session, tmp_path / "labels", tmp_path / "coco", tmp_path / "back"
    points = camera_points(room()).reshape(-1, 3)
    (tmp_path / "cloud.ply").write_bytes(ply(points[np.isfinite(points).all(axis=1)]))
    (tmp_path / "flir.jpg").write_bytes(flir_jpeg(np.full((6, 8), 31.5)))
    commands = [
        ["import", tmp_path / "cloud.ply", tmp_path / "cloud.mcap"],
        ["import", tmp_path / "flir.jpg", tmp_path / "flir.mcap"],
        ["label", session, "--suit", suit, "--out", labels],
        ["info", labels],
        ["validate", labels],
        ["diff", labels, truth],
        ["export", labels, coco, "--format", "coco"],
        ["import", coco, back],
        ["diff", back, labels],
        ["predict", session, "--out", tmp_path / "predicted"],
        ["devices"],
        ["doctor"],
    ]
    for command, (code, said) in zip(commands, run_with_base_only(commands), strict=True):
        assert code == 0, f"{command}: {said}"


def test_a_missing_extra_is_named_in_one_line(rig_session, tmp_path):
    out = tmp_path / "out"
    wanted = {
        "synth": [["compile"], ["simulate", out], ["simulate", out, "--scene", "plate"],
                  ["synth", "generate", "--preset", "upright", "--out", out]],
        "bodies": [["synth", "bodies", "--out", out]],
        "report": [["report", "a", "--out", out]],
        "rig": [["calibrate", "a", "--out", out]],
        "gui": [["fix", "a"]],
        "train": [["train", "a", "--out", out]],
        "synth,report": [["demo", "--out", out]],
    }  # fmt: skip
    pairs = [(extra, command) for extra, commands in wanted.items() for command in commands]
    said = run_with_base_only([command for _, command in pairs])
    for (extra, command), (code, line) in zip(pairs, said, strict=True):
        assert code == 1 and line.count("\n") == 1, (command, line)
        assert f"pip install 'annotate-cloud[{extra}]'" in line, (command, line)
        assert not out.exists()


def test_every_library_that_a_wheel_carries_is_named_with_its_licence():
    named = (ROOT / "THIRD-PARTY.txt").read_text()
    shown = subprocess.run(["ldd", _pcl.__file__], capture_output=True, text=True, check=True).stdout
    libraries = set(re.findall(r"^\s*(lib\w+)", shown, re.M))
    assert "libpcl_common" in libraries
    # manylinux guarantees the rest.
    carried = libraries - {"libc", "libm", "libstdc", "libgcc_s", "libpthread", "libdl", "librt"}
    assert all(f"  {name} " in named for name in carried), carried
    assert len(carried) <= 3, "a wheel would carry unused parts of PCL"
    assert "THIRD-PARTY.txt" in PROJECT["license-files"]


def test_extras_do_not_repeat_the_base():
    base = names_of(PROJECT["dependencies"])
    assert not [e for e, lines in PROJECT["optional-dependencies"].items() if names_of(lines) & base]


def test_pinned_packages_run_on_the_python_of_debian_12():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {canonicalize_name(line.split("==")[0]) for line in lines if "==" in line}
    refusing = [
        f"{found.name} {found.version} wants Python {found.metadata['Requires-Python']}"
        for found in distributions()
        if canonicalize_name(found.name) in pinned
        and "Requires-Python" in found.metadata
        and "3.11.2" not in SpecifierSet(found.metadata["Requires-Python"])
    ]
    assert not refusing


def test_the_version_is_the_same_wherever_it_stands():
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.M)
    told = re.search(r"^## (\d+\.\d+\.\d+), ", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert cited and told and PROJECT["version"] == cited[1] == told[1]
