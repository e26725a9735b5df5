"""Completion at TAB, in bash, zsh and fish."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from annotate.exchange.formats import FORMATS
from annotate.scheme.scheme_file import SHIPPED
from cli.main import app
from synth.images.presets import PRESETS
from synth.rig.difficulty import DIFFICULTIES

COMMAND = Path(sys.executable).with_name("annotate-cloud")
SHELLS = ("bash", "zsh", "fish")


def asked(shell: str, line: str) -> dict[str, str]:
    """Return the environment in which a shell requests the completion of ``line``."""
    words = line.split(" ")
    return {
        "_ANNOTATE_CLOUD_COMPLETE": f"complete_{shell}",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
        "_TYPER_COMPLETE_ARGS": line,
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    }


def offered(shell: str, line: str) -> str:
    return CliRunner().invoke(app, prog_name="annotate-cloud", env=asked(shell, line)).output


@pytest.mark.parametrize("shell", SHELLS)
@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("annotate-cloud sim", ["simulate"]),
        ("annotate-cloud simulate a.mcap --difficulty ", list(DIFFICULTIES)),
        ("annotate-cloud simulate a.mcap --difficulty h", ["hard"]),
        ("annotate-cloud simulate a.mcap --scene ", ["sofa", "chair", "bed", "floor", "plate"]),
        ("annotate-cloud export labels out --format ", list(FORMATS)),
        ("annotate-cloud synth generate --preset ", list(PRESETS)),
        ("annotate-cloud train data --network ", ["compact", "paper", "smp"]),
        ("annotate-cloud label a.mcap --su", ["--suit"]),
        ("annotate-cloud scheme show ", list(SHIPPED)),
    ],
)
def test_verbs_options_and_names_are_offered(shell, line, wanted):
    shown = offered(shell, line)
    assert all(word in shown for word in wanted), shown
    if line.endswith(" h"):
        assert "normal" not in shown


@pytest.mark.parametrize("shell", SHELLS)
def test_each_shell_gets_its_script_installed(shell, tmp_path):
    environment = {
        **os.environ,
        "HOME": str(tmp_path),
        "ZDOTDIR": str(tmp_path),
        "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1",
    }
    for option in ("--show-completion", "--install-completion"):
        done = subprocess.run(
            [COMMAND, option, shell], env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert shell in done.stdout.lower()
    scripts = [path.read_text() for path in tmp_path.rglob("*") if path.is_file()]
    assert any(f"complete_{shell}" in script for script in scripts)


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_in_a_real_bash_a_name_is_completed(tmp_path):
    script = """
        eval "$(_ANNOTATE_CLOUD_COMPLETE=source_bash annotate-cloud)"
        COMP_WORDS=(annotate-cloud simulate a.mcap --difficulty h) COMP_CWORD=4
        _annotate_cloud_completion annotate-cloud
        echo "${COMPREPLY[*]}"
    """
    environment = {**os.environ, "PATH": f"{COMMAND.parent}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "-c", script], env=environment, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.stdout.strip() == "hard", done.stderr
