"""Tables of figures and their measurements on disk."""

import hashlib
import json
import math
import os
import platform
import re
import subprocess
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from sensors.files.atomic import write_bytes
from tools.figures.figure import Figure, Rows, moved

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / "docs" / "figures"
PRODUCT = ("sensors", "annotate", "synth", "eval", "cli", "tools/measure", "tools/correction", ":!*.md")
"""Git's path patterns of the files that change figures."""
COUNT = ".0f"  # format of columns of sample sizes
Kind = Literal["real", "virtual", "synthetic"]


@dataclass(frozen=True)
class Table:
    """A table in the documentation.

    name: of its file and its marks. about: the line below the table. pages: files with the marks. columns:
    heading -> format. measure: seed -> rows. seeded: False if the seed changes nothing. needs: folder of
    recordings without which the table stays.
    """

    name: str
    kind: Kind
    about: str
    pages: tuple[str, ...]
    columns: dict[str, str]
    measure: Callable[[int], Rows]
    seeded: bool = True
    needs: Path | None = None


@dataclass(frozen=True)
class Measured:
    """Rows of a table with their origin, and the rows before; product: "" if copied by hand."""

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
    """Return a digest of the working tree's ``PRODUCT``."""
    state = _git("ls-files", "-s", "--", *PRODUCT) + _git("diff", "--", *PRODUCT)
    return hashlib.sha256(state.encode()).hexdigest()[:16]


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
            row: {c: Figure(*(math.nan if n is None else n for n in v)) for c, v in cells.items()}
            for row, cells in stored[name].items()
        }
    return Measured(**stored)


def _numbers(rows: Rows) -> dict[str, dict[str, list[float | None]]]:
    # JSON lacks NaN; tables print fewer than six digits.
    def plain(figure: Figure) -> list[float | None]:
        return [None if math.isnan(number) else float(f"{number:.6g}") for number in figure]

    return {row: {column: plain(f) for column, f in cells.items()} for row, cells in rows.items()}


def save(table: Table, measured: Measured, folder: Path = KEPT) -> None:
    """Write a measurement."""
    stored = asdict(measured) | {"rows": _numbers(measured.rows), "before": _numbers(measured.before)}
    folder.mkdir(parents=True, exist_ok=True)
    write_bytes(folder / f"{table.name}.json", (json.dumps(stored, indent=1) + "\n").encode())


def is_done(table: Table, old: Measured | None, seed: int, product: str) -> bool:
    """Return whether the last measurement has this seed and product."""
    return old is not None and old.product == product and (old.seed == seed or not table.seeded)


def measure(table: Table, seed: int, product: str, folder: Path = KEPT) -> Measured:
    """Measure a table and write it, with the rows before."""
    old, began = load(table, folder), _cpu_s()
    rows = table.measure(seed)
    measured = Measured(
        rows=rows,
        seed=seed if table.seeded else None,
        product=product,
        commit=_git("rev-parse", "--short", "HEAD").strip(),
        day=f"{datetime.now(UTC):%Y-%m-%d}",
        machine=processor(),
        cpu_s=round(_cpu_s() - began, 1),
        before=old.rows if old else {},
        before_from=origin(old) if old else "",
    )
    save(table, measured, folder)
    return measured


def _cpu_s() -> float:
    """Return the CPU seconds of this process and of its ended children."""
    return sum(os.times()[:4])


def origin(measured: Measured) -> str:
    """Return day, commit and seed of a measurement as text."""
    seed = "" if measured.seed is None else f", seed {measured.seed}"
    return f"{measured.day}, commit `{measured.commit}`{seed}"


def changes(table: Table, measured: Measured) -> list[tuple[str, str, Figure, Figure, bool]]:
    """Return (row, column, old, new, moved) of figures measured before, without sample sizes."""
    return [
        (row, column, old, new, moved(old, new, table.columns[column]))
        for row, cells in measured.rows.items()
        for column, new in cells.items()
        if table.columns[column] != COUNT and (old := measured.before.get(row, {}).get(column)) is not None
    ]
