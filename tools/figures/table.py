"""A table of figures: what it holds, who measures it, where it stands, and its last measurement on disk."""

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
"""What figures depend on, as Git's path patterns: a change of anything else does not make them old."""
COUNT = ".0f"
"""Format of columns that say how much was measured."""
Kind = Literal["real", "virtual", "synthetic"]


@dataclass(frozen=True)
class Table:
    """A table in the documentation.

    name: of its file and its marks. kind: real recordings, the virtual rig, or synthetic images. about: what
    is measured, for the line below the table. pages: files with its marks. columns: heading -> format.
    measure: seed -> rows. seeded: False where the same recordings give the same figures. needs: recordings
    that are not everywhere; without them the table stays as it is.
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
    """Rows of a table, of which seed and product ("" for what was copied by hand), and those before."""

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
    """Digest of everything that figures depend on, as it lies in the working tree."""
    state = _git("ls-files", "-s", "--", *PRODUCT) + _git("diff", "--", *PRODUCT)
    return hashlib.sha256(state.encode()).hexdigest()[:16]


def processor() -> str:
    """Name of this machine's processor."""
    info = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*:\s*(.+)", info.read_text()) if info.is_file() else None
    return found[1] if found else platform.processor() or platform.machine()


def load(table: Table, folder: Path = KEPT) -> Measured | None:
    """The last measurement of a table; None where there is none."""
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
    # NaN is no JSON; six digits are more than any table shows.
    def plain(figure: Figure) -> list[float | None]:
        return [None if math.isnan(number) else float(f"{number:.6g}") for number in figure]

    return {row: {column: plain(f) for column, f in cells.items()} for row, cells in rows.items()}


def save(table: Table, measured: Measured, folder: Path = KEPT) -> None:
    """Keep a measurement."""
    stored = asdict(measured) | {"rows": _numbers(measured.rows), "before": _numbers(measured.before)}
    folder.mkdir(parents=True, exist_ok=True)
    write_bytes(folder / f"{table.name}.json", (json.dumps(stored, indent=1) + "\n").encode())


def is_done(table: Table, old: Measured | None, seed: int, product: str) -> bool:
    """Whether the last measurement is of this very seed and product."""
    return old is not None and old.product == product and (old.seed == seed or not table.seeded)


def measure(table: Table, seed: int, product: str, folder: Path = KEPT) -> Measured:
    """Measure a table now and keep it; what stood there before is kept beside."""
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
    """CPU seconds of this process and of its children that have ended."""
    return sum(os.times()[:4])


def origin(measured: Measured) -> str:
    """Day, commit and seed of a measurement, in words."""
    seed = "" if measured.seed is None else f", seed {measured.seed}"
    return f"{measured.day}, commit `{measured.commit}`{seed}"


def changes(table: Table, measured: Measured) -> list[tuple[str, str, Figure, Figure, bool]]:
    """(row, column, old, new, moved) of every figure that stood in the table before; counts are none."""
    return [
        (row, column, old, new, moved(old, new, table.columns[column]))
        for row, cells in measured.rows.items()
        for column, new in cells.items()
        if table.columns[column] != COUNT and (old := measured.before.get(row, {}).get(column)) is not None
    ]
