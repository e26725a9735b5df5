"""Folders that appear only when they are complete, and folders that must not be replaced."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from glob import escape
from pathlib import Path

from annotate.labelset.claim import CLAIM, Claim, login
from annotate.labelset.journal import JOURNAL
from sensors.errors import ExistsError
from sensors.files.atomic import is_taken, sweep, temporary_of


def check_replaceable(out: Path, marker: str, *inputs: Path) -> None:
    """Check that ``out`` may be removed for a new result: it holds ``marker``, or nothing.

    Raises ExistsError for a folder that no run of this command made, that holds one of its ``inputs``, or
    people's corrections; ClaimedError while somebody writes it.
    """
    for path in inputs:
        if path.resolve().is_relative_to(out.resolve()):
            raise ExistsError(f"{out} holds the input {path}; choose another folder for the result")
    if not (out / marker).is_file() and (not out.is_dir() or any(out.iterdir())):
        raise ExistsError(f"{out} was not made by this command (it has no {marker}); remove it yourself")
    # Dangling links too: both names mean that a person or a process works in the folder.
    if os.path.lexists(out / JOURNAL):
        raise ExistsError(f"{out} holds people's corrections; choose another folder, or remove it yourself")
    if os.path.lexists(out / CLAIM):
        Claim.take(out, login()).release()


@contextmanager
def appearing(out: Path, marker: str, *inputs: Path, overwrite: bool) -> Iterator[Path]:
    """A temporary folder beside ``out`` that takes its name on success and is removed on any error.

    Raises ExistsError when ``out`` is there and is not to be replaced, or must not be.
    """
    if is_taken(out):
        if not overwrite:
            raise ExistsError(f"{out} already exists; choose another folder or pass --overwrite")
        check_replaceable(out, marker, *inputs)
    folder, aside = temporary_of(out), temporary_of(out.with_name(f"{out.name}.old"))
    sweep(out.parent, f".{escape(out.name)}.*.partial")
    for left in (folder, aside):
        shutil.rmtree(left, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        yield folder
        # Aside first: half removed by a process that is killed, it would be nobody's, and in everybody's way.
        if out.exists():
            out.replace(aside)
        folder.replace(out)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    shutil.rmtree(aside, ignore_errors=True)
