"""Atomic folders, which exist only when complete, and checks before a folder is replaced."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from glob import escape
from pathlib import Path

from annotate.labelset.claim import Claim, login
from annotate.labelset.journal import JOURNAL
from sensors.errors import ExistsError, Setting
from sensors.files.atomic import check_folder_name, is_taken, sweep, temporary_of


def check_replaceable(out: Path, marker: str, *inputs: Path) -> None:
    """Check that ``out`` may be removed for a new result: it holds the file ``marker``, or nothing.

    Raises ExistsError for a folder of another origin, or with an input or corrections inside; ClaimedError
    while another process writes it.
    """
    with claimed_to_replace(out, marker, *inputs):
        pass


def check_outside(out: Path, *labels: Path) -> None:
    """Raise ExistsError where a result lies in a label set or a dataset."""
    for path in labels:
        if out.resolve().parent.is_relative_to(path.resolve()):
            raise ExistsError(f"{out} is inside the input {path}; choose another folder")


@contextmanager
def claimed_to_replace(out: Path, marker: str, *inputs: Path) -> Iterator[None]:
    """Hold the claim (writer's lock) on a folder to be replaced. Raises as ``check_replaceable``."""
    for path in inputs:
        if path.resolve().is_relative_to(out.resolve()):
            raise ExistsError(f"{out} holds the input {path}; choose another folder for the result")
    if not (out / marker).is_file() and (not out.is_dir() or any(out.iterdir())):
        raise ExistsError(
            f"{out} was not made by this command (it has no {marker}); choose another folder, or remove it "
            "yourself"
        )
    _check_uncorrected(out)
    with Claim.take(out, login()):
        _check_uncorrected(out)
        yield


def _check_uncorrected(out: Path) -> None:
    # A dangling link too: the name means that a person works in the folder.
    if os.path.lexists(out / JOURNAL):
        raise ExistsError(f"{out} holds people's corrections; choose another folder, or remove it yourself")


def remove(out: Path, marker: str, *inputs: Path) -> None:
    """Remove a folder that an earlier run made. Raises as ``check_replaceable``."""
    with claimed_to_replace(out, marker, *inputs), moved_aside(out):
        pass


@contextmanager
def appearing(out: Path, marker: str, *inputs: Path, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary folder beside ``out``, renamed to ``out`` on success and removed on any error.

    Holds the claim on a replaced folder throughout. Raises ExistsError when ``out`` exists without
    ``overwrite``, and as ``check_replaceable``.
    """
    check_folder_name(out)
    taken = is_taken(out)
    if taken and not overwrite:
        raise ExistsError(f"{out} already exists; choose another folder", Setting.OVERWRITE)
    with claimed_to_replace(out, marker, *inputs) if taken else nullcontext():
        folder = temporary_of(out)
        sweep(out.parent, f".{escape(out.name)}.*.partial")
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        try:
            yield folder
            with moved_aside(out):
                folder.replace(out)
        finally:
            shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def moved_aside(out: Path) -> Iterator[None]:
    """Rename a folder, if it exists, while another takes its name; then remove it, or restore it on an error.

    Rename first, because a killed removal would leave a partial folder under the final name.
    """
    aside = temporary_of(out.with_name(f"{out.name}.old"))
    shutil.rmtree(aside, ignore_errors=True)
    if out.exists():
        out.replace(aside)
    try:
        yield
    except BaseException:
        if aside.exists() and not out.exists():
            aside.replace(out)
        raise
    shutil.rmtree(aside, ignore_errors=True)
