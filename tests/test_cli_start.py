"""How much of the product is imported before a command answers: help and refusals need little of it."""

import json
import subprocess
import sys

import pytest

from cli.training import Without

HEAVY = (
    "numba", "scipy", "skimage", "torch", "onnxruntime",
    "pyvista", "PySide6", "matplotlib", "open3d", "pydantic",
)  # fmt: skip
"""Libraries that each take longer to import than a user waits for an answer without noticing."""

STARTED = """
import contextlib, io, json, sys
from cli.main import main
found = []
for command in json.load(sys.stdin):
    sys.argv = ["annotate-cloud", *command]
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
    found.append((code, said.getvalue(), sorted(sys.modules)))
print(json.dumps(found))
"""
"""Runs commands one after another in one process; after each: exit code, what it said, the modules so far."""


def started(*commands: list[object]) -> list[tuple[int, str, set[str]]]:
    text = json.dumps([[str(word) for word in command] for command in commands])
    python = [sys.executable, "-c", STARTED]
    done = subprocess.run(python, input=text, capture_output=True, text=True, timeout=300, check=True)
    return [(code, said, set(modules)) for code, said, modules in json.loads(done.stdout)]


def test_help_imports_no_numbers_and_info_and_refusals_no_compiler(rig_session, rig_labels, tmp_path):
    nowhere, out, text = tmp_path / "nowhere", tmp_path / "out", tmp_path / "notes.txt"
    text.write_text("no recording")
    helps = [["--help"], ["label", "--help"], ["synth", "generate", "--help"]]
    shown = [["info", rig_session], ["info", rig_labels.path], ["devices"], ["rig"]]
    refused = [
        ["info", nowhere],
        ["info", text],
        ["validate", nowhere],
        ["label", nowhere, "--out", out],
        ["label", rig_session, "--suit", text, "--out", out],
        ["predict", nowhere, "--out", out],
        ["diff", nowhere, rig_labels.path],
        ["evaluate", nowhere, rig_labels.path],
        ["fix", nowhere],
        ["train", nowhere, "--out", out],
        ["learn", nowhere, "--out", out],
        ["export", nowhere, out, "--format", "coco"],
        ["import", nowhere, out],
        ["import", text, tmp_path / "out.mcap"],
        ["repair", nowhere],
        ["record", out],
        ["simulate", out, "--rig", "none"],
        ["simulate", text],
        ["solve", nowhere, "--out", out],
        ["calibrate", nowhere, "--out", out],
        ["compare", nowhere, nowhere],
        ["report", nowhere, "--out", out],
        ["live", nowhere],
        ["demo", "--out", text],
    ]
    done = started(*helps, *shown, *refused)
    for (code, said, modules), command in zip(done, [*helps, *shown, *refused], strict=True):
        assert code == (command in refused), (command, said)
        assert not modules & set(HEAVY), command
        if command in helps:
            assert not modules & {"numpy", "cv2"}, command


def test_every_augmentation_can_be_left_out():
    pytest.importorskip("torch", reason="training needs the extra train")
    from dataclasses import fields

    from eval.training.augment import Augmentation

    assert [one.value for one in Without] == [field.name for field in fields(Augmentation)]
