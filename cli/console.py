"""What a command says: progress on stderr, its result on stdout, errors in one line."""

import json
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeRemainingColumn,
)

from annotate.label_source import Run
from annotate.labelset.appearing import check_replaceable
from sensors.errors import one_line

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]

LINE_SECONDS = 5.0
"""Where stderr is no terminal, progress is a plain line this often."""


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show how far a long run is, with its rate and the time left; yields ``advance(n)``."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines(what, total)
        return
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task, started, done = bar.add_task(what, total=total, rate=""), time.monotonic(), 0

        def advance(n: int) -> None:
            nonlocal done
            done += n
            bar.update(task, advance=n, rate=f"{done / (time.monotonic() - started + 1e-6):.1f}/s")

        yield advance


def _lines(what: str, total: int) -> Callable[[int], None]:
    started = said = time.monotonic()
    done = 0

    def advance(n: int) -> None:
        nonlocal said, done
        done += n
        now = time.monotonic()
        if now - said >= LINE_SECONDS or done >= total:
            said = now
            rate = done / (now - started + 1e-6)
            left = max(0, total - done) / rate if rate else 0
            print(f"{what}: {done}/{total}, {rate:.1f}/s, {left:.0f} s left", file=sys.stderr, flush=True)

    return advance


def finish(result: dict[str, Any], as_json: bool, text: str) -> None:
    """Print a command's result: its JSON object or its lines."""
    print(json.dumps(result, allow_nan=False) if as_json else "\n".join(map(one_line, text.split("\n"))))


def say(line: str) -> None:
    """A remark beside the result, on stderr."""
    print(one_line(line), file=sys.stderr, flush=True)


def finish_run(result: dict[str, Any], run: Run, as_json: bool, text: str) -> None:
    """Print the result of a run over frames, and what it left out; exits with 3 when some frames failed."""
    result["remarks"], total = run.remarks(), len(run.labels)
    for remark, frames in result["remarks"].items():
        say(f"{len(frames)} of {total} frames, first {frames[0]}: {remark}")
    if run.failed:
        result["failed"] = [{"frame": frame, "why": why} for frame, why in run.failed]
        for frame, why in run.failed:
            say(f"frame {frame}: {why}")
    finish(result, as_json, text)
    if run.failed:
        raise typer.Exit(3)


def clear(out: Path, marker: str, overwrite: bool, *inputs: Path) -> None:
    """Remove a folder that an earlier run made (it holds ``marker``), when asked to.

    Raises ExistsError for what must never be removed (``check_replaceable``).
    """
    if overwrite and out.exists():
        check_replaceable(out, marker, *inputs)
        shutil.rmtree(out)
