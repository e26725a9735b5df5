"""Remedies: libraries state faults in words, and verbs name only options that the verbs have."""

import ast
import json
import re
import shutil
from pathlib import Path

from conftest import assert_refused
from typer.main import get_command

from cli.main import app
from cli.remedies import options_of
from sensors.errors import Setting
from sensors.session.reader import Session
from tests.helpers.page_material import write_image_folder
from tests.test_cli_refusals import commands

ROOT = Path(__file__).parents[1]
LIBRARIES = ("sensors", "annotate", "synth", "eval")
WINDOW = "annotate/gui/"  # of the verb fix alone
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
OPTIONS = {tuple(words): options_of(app, words) for words in commands(get_command(app))}
FOREIGN = ("annotate-cloud import --help", "docker run", "--nthreads", "--cflags", "--libs")
"""Options of every verb and of other programs."""


def texts(path):
    """Yield the strings of a file that are not documentation."""
    tree = ast.parse(path.read_text())
    documents = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documents:
            yield node.value


def names_its_verb(text):
    """Return whether every option in a text follows a verb that has the option."""
    before = [text[: found.start()] for found in OPTION.finditer(text)]
    named = zip(OPTION.findall(text), before, strict=True)
    return all(
        any(option in options and " ".join(words) in start for words, options in OPTIONS.items())
        for option, start in named
    )


def test_libraries_name_no_option_without_its_verb():
    for path in (path for library in LIBRARIES for path in sorted((ROOT / library).rglob("*.py"))):
        if not str(path.relative_to(ROOT)).startswith(WINDOW):
            for text in texts(path):
                assert names_its_verb(text) or any(name in text for name in FOREIGN), f"{path}: {text}"


def test_every_setting_is_an_option_of_a_verb():
    options = frozenset().union(*OPTIONS.values())
    assert not [one for one in Setting if f"--{one.value}" not in options]


def test_each_verb_names_its_own_option_for_a_camera(annotate_cloud, tmp_path):
    wrong = {"width": 512, "height": 424, "fx": 3.6, "fy": 3.6, "cx": 254, "cy": 211}
    (file := tmp_path / "camera.json").write_text(json.dumps(wrong))
    (tmp_path / "folder").mkdir()
    generate = ("synth", "generate", "--preset", "people", "--count", 1, "--out", tmp_path / "set")
    refused = annotate_cloud(*generate, "--camera", file)
    assert_refused(refused, "in pixels of this image (--camera)")
    simulate = annotate_cloud("simulate", tmp_path / "x.mcap", "--camera", file)
    assert_refused(simulate, "in pixels of this image (--camera)")


def test_each_verb_names_its_way_to_intrinsics(annotate_cloud, rig_session, tmp_path):
    write_image_folder(folder := tmp_path / "folder", Session(rig_session))
    (folder / "intrinsics.json").unlink()
    shutil.rmtree(folder / "color")
    imported = annotate_cloud("import", folder, tmp_path / "x.mcap")
    assert_refused(imported, "give such a file (--intrinsics)")
    predicted = annotate_cloud("predict", folder, "--out", tmp_path / "out")
    assert_refused(predicted, "give such a file (import --intrinsics)")
    assert "(import --intrinsics)" in annotate_cloud("validate", folder).err


def test_a_verb_with_overwrite_names_it(annotate_cloud, tmp_path):
    (file := tmp_path / "x.mcap").touch()
    refused = annotate_cloud("simulate", file, "--frames", 1)
    assert_refused(refused, "already exists; choose another name or pass --overwrite")
