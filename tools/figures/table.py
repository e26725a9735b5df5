"""Tables of figures and their measurements on disk."""

import hashlib
import json
import math
import os
import platform
import re
import subprocess
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, NamedTuple

from sensors.errors import CloudError
from sensors.files.atomic import write_bytes
from tools.figures.figure import Figure, Rows, moved
from tools.figures.worst_frames import Sheets, write_sheets

ROOT = Path(__file__).resolve().parents[2]
KEPT, IMAGES = ROOT / "docs" / "figures", ROOT / "docs" / "images"
BESIDE = ROOT / "build" / "worst-frames"
"""Folder of the sheets of real people and of development runs; not in the repository."""
FOLDERS = (
    "sensors",
    "annotate",
    "synth",
    "eval",
    "cli",
    "tools/measure",
    "tools/figures",
)
PRINTED = (
    "pages",
    "run",
    "table",
    "tables",
    "worst_frames",
)  # modules of tools/figures that change no figure
PRODUCT = (*FOLDERS, ":!*.md", *(f":!tools/figures/{name}.py" for name in PRINTED))
"""Git's path patterns of the files that change figures."""
FIRST_SEED = 1_000_000_000  # of judging: above every seed that was chosen by hand
DIGITS = 7  # of a commit's SHA, hexadecimal, that give its seed
COUNT = ".0f"  # format of columns of sample sizes
Kind = Literal["real", "mixed", "simulated", "virtual", "synthetic"]


@dataclass(frozen=True)
class Table:
    """A table in the documentation.

    name: of its file and its marks. about: the line below the table. shared: what training and test share,
    and what not, one line. pages: files with the marks. columns: heading -> format. measure: seed -> rows.
    seeded: False if the seed changes nothing. needs: folder of recordings without which the table stays.
    timed: columns of processor time, in which nothing counts as moved. sheets: seed -> worst frames, of which
    contact sheets are written. apart: the page shows the figures from a CSV file beside it.
    """

    name: str
    kind: Kind
    about: str
    shared: str
    pages: tuple[str, ...]
    columns: dict[str, str]
    measure: Callable[[int], Rows]
    seeded: bool = True
    needs: Path | None = None
    timed: tuple[str, ...] = ()
    sheets: Callable[[int], Sheets] | None = None
    apart: bool = False


@dataclass(frozen=True)
class Measured:
    """Rows of a table with their origin, and the rows before.

    seed: of ``judging_seed``; None if it changes nothing. product: digest of the files that change figures.
    """

    rows: Rows
    seed: int | None
    product: str
    commit: str
    day: str
    machine: str
    cpu_s: float
    before: Rows = field(default_factory=dict)
    before_from: str = ""


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout


def product_digest() -> str:
    """Return a digest of the commit's ``PRODUCT``.

    Raises CloudError if a file of the working tree differs from the commit.
    """
    changed = [line[3:] for line in _git("status", "--porcelain", "-uall", "--", *PRODUCT).splitlines()]
    if changed:
        raise CloudError(
            f"{len(changed)} product files differ from the commit, first {changed[0]}; commit them, or give "
            "--seed N for a development run"
        )
    return hashlib.sha256(_git("ls-files", "-s", "--", *PRODUCT).encode()).hexdigest()[:16]


def judging_seed(commit: str) -> int:
    """Return the seed that a commit is judged on, from the first ``DIGITS`` of its SHA."""
    return FIRST_SEED + int(commit[:DIGITS], 16)


def commit_judged(measured: Iterable[Measured | None], product: str) -> str:
    """Return the commit of a measurement of this product, so that a run continues; else the present one."""
    for one in measured:
        if one and one.product == product and one.seed in (None, judging_seed(one.commit)):
            return one.commit
    return _git("rev-parse", "--short=12", "HEAD").strip()


def processor() -> str:
    """Return the name of this machine's processor."""
    info = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*:\s*(.+)", info.read_text()) if info.is_file() else None
    return found[1] if found else platform.processor() or platform.machine()


def load(table: Table, folder: Path = KEPT) -> Measured | None:
    """Return the last measurement of a table, if any."""
    path = folder / f"{table.name}.json"
    if not path.is_file():
        return None
    stored = json.loads(path.read_text())
    for name in ("rows", "before"):
        stored[name] = {
            row: {column: _figure(*numbers) for column, numbers in cells.items()}
            for row, cells in stored[name].items()
        }
    return Measured(**stored)


def _figure(*stored: Any) -> Figure:
    value, low, high, *rest = stored
    return Figure(*map(_number, (value, low, high)), tuple(map(_number, *rest)) if rest else ())


def _number(stored: float | None) -> float:
    return math.nan if stored is None else stored


def _plain(number: float) -> float | None:
    # JSON lacks NaN; tables print fewer than six digits.
    return None if math.isnan(number) else float(f"{number:.6g}")


def _stored(figure: Figure) -> list[Any]:
    ends: list[Any] = [_plain(number) for number in figure[:3]]
    return [*ends, [_plain(number) for number in figure.without]] if figure.without else ends


def rounded(rows: Rows) -> Rows:
    """Return the figures as a file holds them."""
    return {row: {c: _figure(*_stored(figure)) for c, figure in cells.items()} for row, cells in rows.items()}


def _rows_text(rows: Rows) -> str:
    """Return rows as JSON, a line each."""
    cells = ({column: _stored(figure) for column, figure in row.items()} for row in rows.values())
    lines = (f"  {json.dumps(name)}: {json.dumps(row)}" for name, row in zip(rows, cells, strict=True))
    return "{\n" + ",\n".join(lines) + "\n }" if rows else "{}"


def save(table: Table, measured: Measured, folder: Path = KEPT) -> None:
    """Write a table's measurement into its JSON file."""
    names = [one.name for one in fields(Measured)]
    texts = {name: json.dumps(getattr(measured, name)) for name in names if name not in ("rows", "before")}
    texts |= {"rows": _rows_text(measured.rows), "before": _rows_text(measured.before)}
    text = "{\n" + ",\n".join(f' "{name}": {texts[name]}' for name in names) + "\n}\n"
    folder.mkdir(parents=True, exist_ok=True)
    write_bytes(folder / f"{table.name}.json", text.encode())


def is_done(table: Table, old: Measured | None, commit: str, product: str) -> bool:
    """Return whether the last measurement is of this commit and product."""
    return old is not None and (old.product, old.commit, old.seed) == (
        product,
        commit,
        seed_of(table, commit),
    )


def seed_of(table: Table, commit: str) -> int | None:
    """Return the seed that a table's file must have; None if the seed changes nothing."""
    return judging_seed(commit) if table.seeded else None


def measure(table: Table, commit: str, product: str, folder: Path = KEPT) -> Measured:
    """Measure a table on the seed of a commit and write it, with the rows before, unless these are of a
    development seed.
    """
    old, began = load(table, folder), _cpu_s()
    if old and old.seed != seed_of(table, old.commit):
        old = None
    rows = table.measure(judging_seed(commit))
    draw(table, judging_seed(commit), BESIDE if table.kind == "real" else IMAGES)
    measured = Measured(
        rows=rounded(rows),
        seed=seed_of(table, commit),
        product=product,
        commit=commit,
        day=f"{datetime.now(UTC):%Y-%m-%d}",
        machine=processor(),
        cpu_s=round(_cpu_s() - began, 1),
        before=old.rows if old else {},
        before_from=origin(old) if old else "",
    )
    save(table, measured, folder)
    return measured


def draw(table: Table, seed: int, folder: Path) -> None:
    """Write the contact sheets of a table's worst frames into a folder, and print their names."""
    for path in write_sheets(table.sheets(seed), folder) if table.sheets else ():
        print(f"written: {path}", flush=True)


def _cpu_s() -> float:
    """Return the CPU seconds of this process and of its ended children."""
    return sum(os.times()[:4])


def origin(measured: Measured) -> str:
    """Return day, commit and seed of a measurement as text."""
    seed = "" if measured.seed is None else f", seed {measured.seed}"
    return f"{measured.day}, commit `{measured.commit[:DIGITS]}`{seed}"


class Change(NamedTuple):
    """Figure that was measured before. moved: by more than chance."""

    row: str
    column: str
    old: Figure
    new: Figure
    moved: bool


def changes(table: Table, before: Rows, now: Rows, paired: bool) -> list[Change]:
    """Return the figures measured before, without sample sizes and times; paired: on the same recordings."""
    return [
        Change(row, column, old, new, moved(old, new, spec, paired))
        for row, cells in rounded(now).items()
        for column, new in cells.items()
        if (spec := table.columns.get(column, COUNT)) != COUNT and column not in table.timed
        if (old := before.get(row, {}).get(column)) is not None
    ]
