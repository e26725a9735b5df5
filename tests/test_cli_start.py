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


def refusals(session, labels, tmp_path) -> list[list[object]]:
    """What each verb refuses: what is missing, of another kind, taken, unknown by name, or no such number."""
    nowhere, out, text = tmp_path / "nowhere", tmp_path / "out", tmp_path / "notes.txt"
    taken, filled = tmp_path / "taken.mcap", tmp_path / "filled"
    text.write_text("no recording")
    taken.write_text("a session")
    filled.mkdir()
    (filled / "something").write_text("else")
    generate = ["synth", "generate", "--out", out]
    people = [*generate, "--preset", "people"]
    two = ["train-labels", session, session]
    return [
        ["info", nowhere],
        ["info", text],
        ["validate", nowhere],
        ["label", nowhere, "--out", out],
        ["label", session, "--suit", text, "--out", out],
        ["label", session, "--weights", nowhere, "--out", out],
        ["label", session, "--out", filled],
        ["label", session, "--out", filled, "--overwrite"],
        ["predict", nowhere, "--out", out],
        ["predict", session, "--weights", nowhere, "--out", out],
        ["predict", session, "--out", filled],
        ["diff", nowhere, labels],
        ["evaluate", nowhere, labels],
        ["fix", nowhere],
        ["fix", labels, "--session", text],
        ["fix", labels, "--compare", nowhere],
        ["train", nowhere, "--out", out],
        ["train", labels, "--out", filled],
        ["train", labels, "--out", out, "--init", nowhere],
        ["train", labels, "--out", out, "--init", "shipped", "--network", "compact"],
        ["train", labels, "--out", out, "--test", labels, "--hold-out", "anna"],
        [*two[:2], "--out", out],
        [*two, "--out", out, "--truth", nowhere],
        [*two, "--out", out, "--truth", labels, "--truth", text],
        [*two, "--out", out, "--suit", nowhere],
        [*two, "--out", filled],
        ["learn", nowhere, "--out", out],
        ["learn", labels, "--out", out, "--weights", nowhere],
        ["learn", labels, "--out", filled],
        ["suit", "learn", text, "--session", session, "--out", out],
        ["suit", "learn", labels, "--session", text, "--out", out],
        ["export", nowhere, out, "--format", "coco"],
        ["export", labels, out, "--format", "unheard-of"],
        ["export", labels, taken, "--format", "foxglove"],
        ["import", nowhere, out],
        ["import", text, tmp_path / "out.mcap"],
        ["repair", nowhere],
        ["record", out],
        ["record", out, "--device", "toaster"],
        ["record", out, "--device", "virtual:toaster"],
        ["record", out, "--device", "virtual:kinect2?crumbs=1"],
        ["record", taken, "--device", "virtual:kinect2"],
        ["record", out, "--preview", "--device", "toaster"],
        ["simulate", out, "--rig", "none"],
        ["simulate", out, "--scene", "moon"],
        ["simulate", out, "--difficulty", "easy"],
        ["simulate", out, "--suit", nowhere],
        ["simulate", out, "--frames", "2", "--subjects", "3"],
        ["simulate", text],
        generate,
        [*generate, "--preset", "unheard-of"],
        [*generate, "--motion", nowhere],
        [*people, "--motion", nowhere],
        [*people, "--garments", nowhere],
        [*people, "--beside", text],
        ["synth", "generate", "--out", filled, "--preset", "people"],
        ["synth", "film", nowhere, out],
        ["synth", "film", text, out],
        ["synth", "film", text, taken],
        ["synth", "film", text, out, "--difficulty", "easy"],
        ["synth", "page", nowhere],
        ["synth", "page", labels],
        ["solve", nowhere, "--out", out],
        ["calibrate", nowhere, "--out", out],
        ["calibrate", session, "--out", out],
        ["calibrate", out, "--live", "--device", "toaster", "--out", out],
        ["compare", nowhere, nowhere],
        ["report", nowhere, "--out", out],
        ["live", nowhere],
        ["live", text],
        ["live", "--device", "toaster"],
        ["live", "--device", "virtual:kinect2", "--suit", nowhere],
        ["live", "--device", "virtual:kinect2", "--record", taken],
        ["live", session, "--record", out],
        ["demo", "--out", text],
    ]


def test_help_imports_no_numbers_and_info_and_refusals_no_compiler(rig_session, rig_labels, tmp_path):
    helps = [["--help"], ["label", "--help"], ["synth", "generate", "--help"]]
    shown = [["info", rig_session], ["info", rig_labels.path], ["devices"], ["rig"]]
    refused = refusals(rig_session, rig_labels.path, tmp_path)
    done = started(*helps, *shown, *refused)
    for (code, said, modules), command in zip(done, [*helps, *shown, *refused], strict=True):
        assert code == (command in refused), (command, said)
        assert not modules & set(HEAVY), command
        if command in helps:
            assert not modules & {"numpy", "cv2"}, command


def test_names_of_choices_are_those_of_what_they_choose():
    pytest.importorskip("scipy", reason="people need the extra synth")
    from synth import choices
    from synth.images.presets import PRESETS
    from synth.rig.difficulty import DIFFICULTIES

    assert tuple(PRESETS) == choices.PRESETS and tuple(DIFFICULTIES) == choices.DIFFICULTIES


def test_every_augmentation_can_be_left_out():
    pytest.importorskip("torch", reason="training needs the extra train")
    from dataclasses import fields

    from eval.training.augment import Augmentation

    assert [one.value for one in Without] == [field.name for field in fields(Augmentation)]
