"""The command imports nothing from the current folder."""

import subprocess

import pytest

from annotate.gui.display import check_screen
from cli.verbs.labels.correction import learn_command
from sensors.errors import CloudError


@pytest.fixture
def foreign(tmp_path, monkeypatch):
    """The current folder, with modules of well-known names; each leaves a mark when it is imported."""
    for name in ("PySide6", "cli", "multiprocessing", "numpy"):
        (tmp_path / name).mkdir()
        code = f"import pathlib; pathlib.Path({str(tmp_path)!r}, 'ran-{name}').touch()\n"
        (tmp_path / name / "__init__.py").write_text(code)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    monkeypatch.setenv("QT_QPA_PLATFORM", "offscreen")
    monkeypatch.setenv("DISPLAY", ":0")
    yield tmp_path
    assert not list(tmp_path.glob("ran-*"))


def test_the_probe_of_the_screen_runs_no_code_of_the_folder(foreign):
    pytest.importorskip("PySide6")
    try:
        check_screen()
    except CloudError as error:
        assert "OpenGL" in str(error)  # drawn offscreen there is none


def test_learning_runs_no_code_of_the_folder(foreign):
    command = learn_command(foreign / "labels", None, foreign / "model")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "labels" in done.stderr


def test_workers_run_no_code_of_the_folder(annotate_cloud, foreign):
    command = ("synth", "generate", "--preset", "sitting-test", "--count", 2, "--workers", 2, "--out", "made")
    done = annotate_cloud(*command)
    assert done.code == 0, done.err
