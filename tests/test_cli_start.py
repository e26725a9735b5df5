"""How much of the product is imported before a command answers: help and refusals need little of it."""

import json
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest

from cli.verbs.training import Without

SHIPPED = Path(str(files("eval").joinpath("weights")))
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


REFUSALS = """
info AT/nowhere
info AT/notes.txt
validate AT/nowhere
label AT/nowhere --out AT/out
label SESSION --suit AT/notes.txt --out AT/out
label SESSION --weights AT/nowhere --out AT/out
label SESSION --out AT/filled
label SESSION --out AT/filled --overwrite
predict AT/nowhere --out AT/out
predict SESSION --weights AT/nowhere --out AT/out
predict SESSION --out AT/filled
diff AT/nowhere LABELS
evaluate AT/nowhere LABELS
fix AT/nowhere
fix LABELS --session AT/notes.txt
fix LABELS --compare AT/nowhere
train AT/nowhere --out AT/out
train LABELS --out AT/filled
train LABELS --out AT/out --init AT/nowhere
train LABELS --out AT/out --init shipped --network compact
train LABELS --out AT/out --test LABELS --hold-out anna
train-labels SESSION --out AT/out
train-labels SESSION SESSION --out AT/out --truth AT/nowhere
train-labels SESSION SESSION --out AT/out --truth LABELS --truth AT/notes.txt
train-labels SESSION SESSION --out AT/out --suit AT/nowhere
train-labels SESSION SESSION --out AT/filled
learn AT/nowhere --out AT/out
learn LABELS --out AT/out --weights AT/nowhere
learn LABELS --out AT/filled
suit learn AT/notes.txt --session SESSION --out AT/out
suit learn LABELS --session AT/notes.txt --out AT/out
export AT/nowhere AT/out --format coco
export LABELS AT/out --format unheard-of
export LABELS AT/taken.mcap --format foxglove
import AT/nowhere AT/out
import AT/notes.txt AT/out.mcap
repair AT/nowhere
record AT/out
record AT/out --device toaster
record AT/out --device virtual:toaster
record AT/out --device virtual:kinect2?crumbs=1
record AT/taken.mcap --device virtual:kinect2
record AT/out --preview --device toaster
simulate AT/out --rig none
simulate AT/out --difficulty easy
simulate AT/out --suit AT/nowhere
simulate AT/notes.txt
synth generate --out AT/out
synth generate --out AT/out --motion AT/nowhere
synth generate --out AT/out --preset people --motion AT/nowhere
synth generate --out AT/out --preset people --garments AT/nowhere
synth generate --out AT/out --preset people --beside AT/notes.txt
synth generate --out AT/filled --preset people
synth bodies --table AT/notes.txt --out AT/out
synth film AT/nowhere AT/out
synth film AT/notes.txt AT/out
synth film AT/notes.txt AT/taken.mcap
synth film AT/notes.txt AT/out --difficulty easy
synth page AT/nowhere
synth page LABELS
solve AT/nowhere --out AT/out
calibrate AT/nowhere --out AT/out
calibrate SESSION --out AT/out
calibrate AT/out --live --device toaster --out AT/out
compare AT/nowhere AT/nowhere
compare AT/cut.npz AT/cut.npz
report AT/nowhere --out AT/out
report AT/cut.npz --out AT/out
live AT/nowhere
live AT/notes.txt
live --device toaster
live --device virtual:kinect2 --suit AT/nowhere
live --device virtual:kinect2 --record AT/taken.mcap
live SESSION --record AT/out
demo --out AT/notes.txt
"""
"""Commands whose files or names are missing, of another kind, taken or unknown, or whose numbers are none."""


def started(*commands: list[object]) -> list[tuple[int, str, set[str]]]:
    text = json.dumps([[str(word) for word in command] for command in commands])
    python = [sys.executable, "-c", STARTED]
    done = subprocess.run(python, input=text, capture_output=True, text=True, timeout=300, check=True)
    return [(code, said, set(modules)) for code, said, modules in json.loads(done.stdout)]


def refusals(session, labels, tmp_path) -> list[list[str]]:
    """The words of each of REFUSALS: with a recording, its labels, and a folder of what is there already."""
    (tmp_path / "notes.txt").write_text("no recording")
    (tmp_path / "taken.mcap").write_text("a session")
    (tmp_path / "filled").mkdir()
    (tmp_path / "filled" / "something").write_text("else")
    (tmp_path / "empty").mkdir()
    (tmp_path / "cut.npz").write_bytes(b"PK\x03\x04 and no more")
    text = (
        REFUSALS.replace("AT", str(tmp_path)).replace("SESSION", str(session)).replace("LABELS", str(labels))
    )
    return [line.split() for line in text.strip().splitlines()]


def test_help_imports_no_numbers_and_info_and_refusals_no_compiler(rig_session, rig_labels, tmp_path):
    helps = [["--help"], ["label", "--help"], ["synth", "generate", "--help"]]
    shown = [["info", rig_session], ["info", rig_labels.path], ["devices"], ["rig"]]
    refused = refusals(rig_session, rig_labels.path, tmp_path)
    done = started(*helps, *shown, *refused)
    for (code, said, modules), command in zip(done, [*helps, *shown, *refused], strict=True):
        assert code == (command in refused), (command, said)
        assert not modules & set(HEAVY), command
        if command in helps:
            assert not modules & {"numpy", "cv2", "packaging.requirements"}, command
        if command in shown[:2]:
            # No image of a session is decoded, and of labels only the parts: by Pillow.
            assert not modules & ({"cv2", "PIL.Image"} if command == shown[0] else {"cv2"}), command


def test_every_augmentation_can_be_left_out():
    pytest.importorskip("torch", reason="training needs the extra train")
    from dataclasses import fields

    from eval.training.augment import Augmentation

    assert [one.value for one in Without] == [field.name for field in fields(Augmentation)]
