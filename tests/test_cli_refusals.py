"""Help of every verb, and refusals: one line on stderr, exit 1, nothing written."""

from dataclasses import fields
from importlib.resources import files
from pathlib import Path

import pytest
from conftest import assert_refused, tree
from typer.main import get_command

from cli.main import app

SHIPPED = Path(str(files("eval").joinpath("weights")))
REFUSALS = """
info AT/nowhere
info AT/notes.txt
validate AT/nowhere
label AT/nowhere --out AT/out
label SESSION --suit AT/notes.txt --out AT/out
label SESSION --weights AT/nowhere --out AT/out
label SESSION --out AT/filled
label SESSION --out AT/filled --overwrite
label SESSION --suit AT --out AT/out
predict AT/nowhere --out AT/out
predict SESSION --weights AT/nowhere --out AT/out
predict SESSION --out AT/filled
predict SESSION --out AT/filled --overwrite
predict SESSION --out AT/filled --overwrite --everybody --probabilities
predict SESSION --out AT/filled --overwrite --again --everybody
predict SESSION --learnt AT/cut.onnx --out AT/out
diff AT/nowhere LABELS
evaluate AT/nowhere LABELS
evaluate LABELS AT/empty
evaluate LABELS LABELS --out AT/taken.mcap
evaluate AT/nowhere LABELS --out AT/taken.mcap
fix AT/nowhere
fix LABELS --session AT/notes.txt
fix LABELS --compare AT/nowhere
train AT/nowhere --out AT/out
train LABELS --out AT/filled
train LABELS --out AT/filled --overwrite
train AT/nowhere --out AT/filled --overwrite
train LABELS --out AT/out --hold-out zoe
train LABELS --out AT/out --epochs 2 --minutes 1
train LABELS --out AT/out --init AT/cut.safetensors
train LABELS --out AT/out --test AT/nowhere
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
import SESSION AT/taken.mcap
repair AT/nowhere
repair AT
record AT/out
record AT/out --device toaster
record AT/out --device virtual:toaster
record AT/out --device virtual:kinect2?crumbs=1
record AT/taken.mcap --device virtual:kinect2
record AT/out --preview --device toaster
simulate AT/out --rig none
simulate AT/out --difficulty easy
simulate AT/out --scene beach
simulate AT/out --frames 2 --subjects 3
simulate AT/filled --frames 1 --overwrite
simulate AT/out --suit AT/nowhere
simulate AT/notes.txt
synth generate --out AT/out
synth generate --out AT/out --motion AT/nowhere
synth generate --out AT/out --preset people --motion AT/nowhere
synth generate --out AT/out --preset people --garments AT/nowhere
synth generate --out AT/out --preset people --beside AT/notes.txt
synth generate --out AT/filled --preset people
synth generate --out AT/filled --preset people --count 1 --overwrite
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
compare LABELS AT/cut.npz
report AT/nowhere --out AT/out
report AT/cut.npz --out AT/out
live AT/nowhere
live AT/notes.txt
live --device toaster
live --device virtual:kinect2 --suit AT/nowhere
live --device virtual:kinect2 --record AT/taken.mcap
live SESSION --record AT/out
demo --out AT/notes.txt
demo --out AT/filled
demo --out AT/filled --overwrite
"""
"""Commands with missing, foreign, taken or unknown files and names, and options that exclude each other."""

OTHER_FORMATS = """
.npz evaluate LABELS LABELS --out AT/out.json
.html report LABELS LABELS --out AT/out.pdf
.html report AT/cut.npz --out AT/out.csv
.jsonl,.csv predict SESSION --out AT/labels --joints AT/out.txt
.mcap simulate AT/out.bag --frames 1
.mcap simulate AT/out.truth --frames 1 --scene plate
.mcap record AT/out.mp4 --device virtual:kinect2 --seconds 0.1
.mcap live --device virtual:kinect2 --no-window --record AT/out.zip --seconds 0.1
.mcap repair SESSION --out AT/out.bag
.mcap strip SESSION AT/out.png --colour
.mcap export LABELS AT/out.json --format foxglove
.mcap calibrate AT/out.bag --live --device virtual:kinect2 --out AT/rig.json
.json calibrate SESSION --out AT/out.png
.toml suit learn LABELS --session SESSION --out AT/out.json
.toml scheme new AT/out.json
.toml scheme colours paper --out AT/out.json
.npz solve AT/notes.txt --out AT/out.c3d
.png solve AT/notes.txt --out AT/walk.npz --picture AT/out.jpg
.webp,.gif,.png solve AT/notes.txt --out AT/walk.npz --film AT/out.mp4
.mcap synth film AT/notes.txt AT/out.mp4
"""
"""Suffixes of an output, and a command that gives it another."""


FOLDERS = """
label SESSION --out AT/out.mcap
predict SESSION --out AT/out.onnx
predict LABELS --out AT/out.npz
try SESSION --out AT/out.html
learn LABELS --out AT/out.onnx
train LABELS --out AT/out.onnx
adapt LABELS --out AT/out.onnx
convert LABELS --scheme six --out AT/out.toml
export LABELS AT/out.json --format coco
synth generate --preset people --out AT/out.tar
rig kinect2-optris --out AT/out.toml
demo --out AT/out.html
"""
"""Commands that write a folder, with the name of a file."""


def commands(group, path=()):
    """Yield the words of every command of the program."""
    for name, one in group.commands.items():
        yield from commands(one, (*path, name)) if hasattr(one, "commands") else [(*path, name)]


@pytest.mark.parametrize("words", list(commands(get_command(app))), ids=" ".join)
def test_every_verb_has_help(annotate_cloud, words):
    shown = annotate_cloud(*words, "--help")
    assert shown.code == 0 and "Usage: " in shown.out and words[-1] in shown.out


@pytest.fixture(scope="module")
def files_there(rig_session, rig_labels, tmp_path_factory) -> Path:
    """Return a folder with files that are there already, or are of another kind."""
    folder = tmp_path_factory.mktemp("there")
    (folder / "notes.txt").write_text("no recording")
    (folder / "taken.mcap").write_text("a session")
    (folder / "filled").mkdir()
    (folder / "filled" / "something").write_text("else")
    (folder / "empty").mkdir()
    (folder / "cut.npz").write_bytes(b"PK\x03\x04 and no more")
    for kind in ("onnx", "safetensors"):
        (folder / f"cut.{kind}").write_bytes((SHIPPED / f"compact.{kind}").read_bytes()[:3000])
    return folder


@pytest.mark.parametrize("command", REFUSALS.strip().splitlines())
def test_a_refusal_is_one_line_and_writes_nothing(
    annotate_cloud, files_there, rig_session, rig_labels, command
):
    before = tree(files_there)
    names = {"SESSION": rig_session, "LABELS": rig_labels.path}
    done = annotate_cloud(
        *(names.get(word, word.replace("AT", str(files_there), 1)) for word in command.split())
    )
    assert done.code in (1, 2) and done.out == "" and "Traceback" not in done.err
    if done.code == 1:
        lines = done.err.splitlines()
        assert lines[-1].startswith("annotate-cloud: ") and len(lines) <= 2, done.err
    assert tree(files_there) == before


@pytest.mark.parametrize("command", OTHER_FORMATS.strip().splitlines())
def test_an_output_named_as_another_format_is_refused(
    annotate_cloud, files_there, rig_session, rig_labels, command
):
    before = tree(files_there)
    wanted, *words = command.split()
    names = {"SESSION": rig_session, "LABELS": rig_labels.path}
    done = annotate_cloud(*(names.get(word, word.replace("AT", str(files_there), 1)) for word in words))
    suffix = next(Path(word).suffix for word in words if "AT/out" in word)
    assert_refused(done, f"has the suffix '{suffix}'; give a name that ends in {wanted.replace(',', ' or ')}")
    assert tree(files_there) == before


@pytest.mark.parametrize("command", FOLDERS.strip().splitlines())
def test_a_folder_named_as_a_file_is_refused(annotate_cloud, files_there, rig_session, rig_labels, command):
    before = tree(files_there)
    names = {"SESSION": rig_session, "LABELS": rig_labels.path}
    done = annotate_cloud(
        *(names.get(word, word.replace("AT", str(files_there), 1)) for word in command.split())
    )
    remarks = len(done.err.splitlines()) - 1
    assert_refused(done, "of a file; give the name of a folder", remarks=remarks)
    assert tree(files_there) == before


def test_every_augmentation_can_be_left_out():
    pytest.importorskip("torch", reason="training needs the extra train")
    from cli.verbs.training import Without
    from eval.training.augment import Augmentation

    assert [one.value for one in Without] == [field.name for field in fields(Augmentation)]
