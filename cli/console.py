"""The output of a command: progress on stderr, its result on stdout as a table or as JSON."""

import json
import math
import re
import shlex
import shutil
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text
from typer import Option

from cli.remedies import remedied
from sensors.errors import ExistsError, Setting, one_line
from sensors.files.atomic import check_folder_name, is_taken

if TYPE_CHECKING:
    from annotate.label_recording import Run

Json = Annotated[bool, Option("--json", help="Print one JSON object on stdout.")]
Overwrite = Annotated[bool, Option("--overwrite", help="Replace existing output.")]
Names = Annotated[bool, Option("--names", help="Keep names of people in place of codes.")]

LINE_SECONDS = 5.0  # s between two lines of progress without a terminal; untuned
WIDTH = 110  # columns of a table without a terminal; untuned
NUMBER = re.compile(r"[+-]?[\d.,]+( ?%)?|-")
# As in ``sensors.recording.arrival_times``.
DROPPED = re.compile(r"(?P<stream>\w+): (?P<lost>\d+) dropped(?:, (?P<slow>\d+) as writing was too slow)?")


class Block(str):
    """Text of several lines for a terminal; no name in the text breaks a line."""


def block(*texts: str, gap: str = "\n\n") -> Block:
    """Return texts one below the other, with ``gap`` in between; any text but a Block is one line."""
    return Block(gap.join(text if isinstance(text, Block) else one_line(text) for text in texts))


@contextmanager
def progress(title: str, total: int | None) -> Iterator[Callable[[int], None]]:
    """Show progress, rate and time left of a run; yield ``advance(n)``. total: None = unknown."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines(title, total)
        return
    from rich import progress as bars

    columns = (
        *(bars.SpinnerColumn(), bars.TextColumn("{task.description}"), bars.BarColumn()),
        *(bars.MofNCompleteColumn(), bars.TextColumn("{task.fields[rate]}"), bars.TimeRemainingColumn()),
    )
    with bars.Progress(*columns, console=console, transient=True) as bar:
        task, started, done = bar.add_task(title, total=total, rate=""), time.monotonic(), 0

        def advance(n: int) -> None:
            nonlocal done
            done += n
            bar.update(task, advance=n, rate=f"{done / (time.monotonic() - started + 1e-6):.1f}/s")

        yield advance


def _lines(title: str, total: int | None) -> Callable[[int], None]:
    started = printed = time.monotonic()
    done = 0

    def advance(n: int) -> None:
        nonlocal printed, done
        done += n
        now = time.monotonic()
        if now - printed >= LINE_SECONDS or (total is not None and done >= total):
            printed, rate = now, done / (now - started + 1e-6)
            of, end = "", ""
            if total is not None:
                of, end = f"/{total}", f", {max(0, total - done) / rate if rate else 0:.0f} s left"
            print(f"{title}: {done}{of}, {rate:.1f}/s{end}", file=sys.stderr, flush=True)

    return advance


def cell(value: object, unit: str = "") -> str:
    """Return a value as readable text: numbers to three digits, then the unit; None and NaN as a dash."""
    match value:
        case None:
            return "-"
        case bool():
            return "yes" if value else "no"
        case int():
            text = f"{value:,}"
        case float():
            if not math.isfinite(value):
                return "-"
            size = abs(value)
            text = f"{value:,.0f}" if size >= 99.95 else f"{value:#.3g}" if size >= 0.1 else f"{value:.3g}"
        case Mapping():
            return ", ".join(f"{cell(name)} {cell(one)}" for name, one in value.items()) or "-"
        case list() | tuple():
            return ", ".join(map(cell, value)) or "-"
        case _:
            return one_line(str(value)) or "-"
    return f"{text} {unit}" if unit else text


def table(columns: Sequence[str], rows: Iterable[Sequence[object]], title: str = "") -> Block:
    """Return the lines of a table, its values as ``cell`` writes them.

    columns: names, with the unit if any ("time, s"). Columns of numbers are set to the right.
    """
    lines = [[cell(value) for value in row] for row in rows]
    shown = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, show_header=any(columns))
    for name, values in zip(columns, zip(*lines, strict=True) if lines else [()] * len(columns), strict=True):
        numbers = set(values) != {"-"} and all(map(NUMBER.fullmatch, values))
        shown.add_column(name, justify="right" if numbers else "left", overflow="fold")
    for line in lines:
        # Names come from outside: as Text they cannot be markup.
        shown.add_row(*map(Text, line))
    console = Console(width=shutil.get_terminal_size((WIDTH, 24)).columns, no_color=True, highlight=False)
    with console.capture() as captured:
        console.print(*([Text(one_line(title))] if title else []), shown, sep="\n")
    return Block("\n".join(line.rstrip() for line in captured.get().rstrip().split("\n")))


def facts(values: Mapping[str, object]) -> Block:
    """Return lines of two columns without a heading: names, and values as ``cell`` writes them."""
    return table(("", ""), [(name.replace("_", " "), cell(value)) for name, value in values.items()])


def event_lines(events: Mapping[str, int]) -> list[str]:
    """Return a line for each text, and one line for all lost images of a stream.

    events: number of occurrences of each text in a recording.
    """
    lines, gaps, lost, slow = list[str](), Counter[str](), Counter[str](), Counter[str]()
    for text, times in events.items():
        found = DROPPED.fullmatch(text)
        if found is None:
            lines.append(text + (f" ({times} times)" if times > 1 else ""))
            continue
        stream = found["stream"]
        gaps[stream] += times
        lost[stream] += times * int(found["lost"])
        slow[stream] += times * int(found["slow"] or 0)
    for stream, times in gaps.items():
        places = f" in {times:,} gaps" if times > 1 else ""
        why = f", {slow[stream]:,} as writing was too slow" if slow[stream] else ""
        lines.append(f"{stream}: {lost[stream]:,} dropped{places}{why}")
    return lines


def provenance() -> dict[str, str]:
    """Return the running command and the version, for files that record their origin."""
    from importlib.metadata import version

    return {"command": shlex.join(["annotate-cloud", *sys.argv[1:]]), "version": version("annotate-cloud")}


def say(*lines: str) -> None:
    """Print remarks on stderr."""
    for line in lines:
        print(one_line(remedied(line)), file=sys.stderr, flush=True)


def finish(result: dict[str, Any], as_json: bool, *texts: str) -> None:
    """Print a command's result: its JSON object, or its texts, each from a new line (``block``)."""
    print(json.dumps(result, allow_nan=False) if as_json else block(*texts, gap="\n"))


def finish_run(result: dict[str, Any], run: "Run", as_json: bool, text: str) -> None:
    """Print the result of a run over frames, its remarks and failed frames; exit with 3 if a frame failed."""
    result["remarks"], total = run.remarks(), len(run.labels)
    for remark, frames in result["remarks"].items():
        say(f"{len(frames)} of {total} frames, first {frames[0]}: {remark}")
    if run.failed:
        result["failed"] = [{"frame": frame, "why": why} for frame, why in run.failed]
        say(*(f"frame {frame}: {why}" for frame, why in run.failed))
    finish(result, as_json, text)
    if run.failed:
        raise typer.Exit(3)


def check_room(out: Path, marker: str, overwrite: bool, *inputs: Path) -> None:
    """Raise ExistsError unless a folder is new, contains the file ``marker``, or may be replaced.

    Raises CloudError for a new folder with the name of a file.
    """
    from annotate.labelset.atomic_folder import check_replaceable

    check_folder_name(out)
    if overwrite and out.exists():
        check_replaceable(out, marker, *inputs)
    elif is_taken(out) and not (out / marker).is_file():
        raise ExistsError(f"{out} already exists; choose another folder", Setting.OVERWRITE)


def clear(out: Path, marker: str, overwrite: bool, *inputs: Path) -> None:
    """Remove an earlier run's folder ``out`` if ``overwrite`` is set.

    marker: file that such a folder contains. inputs: paths of the command, which must not lie in ``out``.
    Raises ExistsError for a folder that must not be removed (``check_replaceable``).
    """
    if overwrite and out.exists():
        from annotate.labelset.atomic_folder import remove

        remove(out, marker, *inputs)
