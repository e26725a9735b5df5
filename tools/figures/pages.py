"""Tables of figures as Markdown, written into the pages between their marks."""

import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

from sensors.files.atomic import write_bytes
from tools.figures.figure import Rows
from tools.figures.inputs import conclusion
from tools.figures.table import IMAGES, ROOT, Measured, Table, changes, load, origin

KINDS = {
    "real": "Recordings of real people",
    "mixed": "Recordings of real people, virtual rig, synthetic images",
    "simulated": "Virtual rig, synthetic images",
    "virtual": "Virtual rig",
    "synthetic": "Synthetic images",
}
Lines = list[list[str]]  # cells of a table, its heads first
APART = """[{0}.csv](figures/{0}.csv):

```{{csv-table}}
:file: figures/{0}.csv
:header-rows: 1
```"""
"""Block of a table whose figures are in a CSV file beside the page; the link is for sites of code."""
MARK = re.compile(r"(<!-- figures: (?P<name>[\w-]+) -->\n).*?(<!-- end of figures -->)", re.S)
MOVED = "moved"  # mark of the figures that moved
PAGES = {"README.md", "docs/figures.md"}  # with marks of derived blocks
RGBD, REAL_PEOPLE = "rgbd", "real-people"  # tables
SHEETS = {
    "rig-suit": "Virtual rig, suit",
    "rig-predict": "Virtual rig, `predict`",
    "rig-joints": "Virtual rig, joints of `predict`",
    "sitting-test": "Synthetic images, `sitting-test`",
    "recumbent": "Synthetic images, `recumbent`",
    "upright": "Synthetic images, `upright`",
    "people": "Synthetic images, `people`",
    "standing": "Synthetic images, `standing`",
    "images-joints": "Synthetic images, joints of `predict`",
}
"""Titles of the sheets of worst frames, by name."""
DIGEST = {
    "frames": ("frames", "images", ".0f"),
    "joints right": ("parts right", "joints right", ".3f"),
    "on the other side": ("other side", "on the other side", ".1%"),
    "within a fifth": ("within a fifth", "", ".3f"),
    "facing to 30 degrees": ("facing to 30 degrees", "facing to 30 degrees", ".3f"),
}
"""Columns of real people: their columns in `rgbd` and in `real-people`, and format."""
DIGEST_ROWS = {
    f"{place}, {what}": (RGBD, f"`{recording}`, {reading}")
    for recording, place in (("sofa", "on a sofa"), ("upper_body", "from the hips up"))
    for what, reading in (("`predict`", "`predict`"), ("colour network", "colour network, depth looked up"))
} | {"27 actions, cut out, `predict`": (REAL_PEOPLE, "single frames of 27 actions")}
"""Rows of real people: table and its row."""


def spliced(text: str, block_of: Callable[[str], str | None]) -> str:
    """Return a page with every marked block written anew; a block of None stays."""

    def block(match: re.Match[str]) -> str:
        new = block_of(match["name"])
        return match[0] if new is None else f"{match[1]}\n{new.strip()}\n\n{match[3]}"

    return MARK.sub(block, text)


def markdown(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table."""
    lines = [list(heads), *map(list, rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def joined(rows: Mapping[str, list[str]]) -> Iterable[tuple[str, tuple[str, ...]]]:
    """Return rows of the same cells as one row with all their names."""
    names: dict[tuple[str, ...], list[str]] = {}
    for name, cells in rows.items():
        names.setdefault(tuple(cells), []).append(name)
    return (("; ".join(alike), cells) for cells, alike in names.items())


def lines_of(table: Table, rows: Rows) -> Lines:
    """Return the heads and lines of a table's figures; rows that print the same figures are one line."""
    shown = {
        name: [cells[c].text(spec) if c in cells else "-" for c, spec in table.columns.items()]
        for name, cells in rows.items()
    }
    return [["", *table.columns], *([names, *cells] for names, cells in joined(shown))]


def markdown_of(table: Table, rows: Rows) -> str:
    """Return the Markdown of a table's figures."""
    heads, *lines = lines_of(table, rows)
    return markdown(heads, lines)


def csv_of(lines: Lines) -> bytes:
    """Return heads and lines as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue().encode()


def table_block(table: Table, measured: Measured) -> str:
    """Return a table of figures with its source below."""
    command = f"`make figures ONLY={table.name}`"
    from_ = f"{KINDS[table.kind]}: {table.about} {command}, {origin(measured)}."
    shown = APART.format(table.name) if table.apart else markdown_of(table, measured.rows)
    return f"{shown}\n\n{from_} {table.shared}"


def digest(measured: Mapping[str, Measured]) -> str | None:
    """Return the small table of real people, from the rows that were measured."""
    lines = []
    for name, (table, row) in DIGEST_ROWS.items():
        if table in measured and (cells := measured[table].rows.get(row)):
            columns = ((names[table == REAL_PEOPLE], spec) for *names, spec in DIGEST.values())
            lines.append([name, *(cells[c].text(spec) if c in cells else "-" for c, spec in columns)])
    return markdown(["", *DIGEST], lines) if lines else None


def pictures(measured: Mapping[str, Measured]) -> str | None:
    """Return the links to the sheets of worst frames that were written."""
    shown = {name: title for name, title in SHEETS.items() if (IMAGES / f"worst-{name}.webp").is_file()}
    links = (f"![{title}](images/worst-{name}.webp)\n\n*{title}*" for name, title in shown.items())
    return "\n\n".join(links) or None


DERIVED: dict[str, Callable[[Mapping[str, Measured]], str | None]] = {
    "inputs-conclusion": lambda found: conclusion(found["inputs"].rows) if "inputs" in found else None,
    "real": digest,
    "worst-frames": pictures,
}
"""Functions that write other blocks from the measured tables, by mark."""


def moved_lines(tables: Iterable[Table], all_measured: Mapping[str, Measured]) -> tuple[int, Lines]:
    """Return the number of compared figures, and heads and lines of the figures that moved since before."""
    lines, compared = [["table", "row", "figure", "before", "now", "before: measured"]], 0
    for table in tables:
        if (measured := all_measured.get(table.name)) is None:
            continue
        found = changes(table, measured.before, measured.rows, paired=not table.seeded)
        compared += len(found)
        for one in (one for one in found if one.moved):
            old, new = (figure.text(table.columns[one.column]) for figure in (one.old, one.new))
            lines.append([table.name, one.row, one.column, old, new, measured.before_from])
    return compared, lines


def moved_block(compared: int, lines: Lines) -> str:
    """Return a sentence on the figures that moved, and their file."""
    return f"{said_of(compared, len(lines) - 1)}\n\n{APART.format(MOVED)}"


def said_of(compared: int, count: int) -> str:
    """Return a sentence on the number of moved figures."""
    return (
        f"{compared} figures stood here before; {count} of them have moved by more than chance. "
        "Chance alone moves at most 5 %."
    )


def files_of(tables: list[Table], root: Path) -> Iterator[tuple[Path, bytes]]:
    """Yield the pages and CSV files that hold measured tables, with their content by the measurements."""
    known = {table.name: table for table in tables}
    measured = {name: found for name, table in known.items() if (found := load(table, root / "docs/figures"))}
    compared, lines = moved_lines(tables, measured)

    def block_of(name: str) -> str | None:
        if name == MOVED:
            return moved_block(compared, lines)
        if name in DERIVED:
            return DERIVED[name](measured)
        return table_block(known[name], measured[name]) if name in measured else None

    for name, found in measured.items():
        if known[name].apart:
            yield root / f"docs/figures/{name}.csv", csv_of(lines_of(known[name], found.rows))
    yield root / f"docs/figures/{MOVED}.csv", csv_of(lines)
    for page in sorted({page for table in tables for page in table.pages} | PAGES):
        yield root / page, spliced((root / page).read_text(), block_of).encode()


def write_pages(tables: list[Table], root: Path = ROOT) -> list[Path]:
    """Write all measured tables into the pages with their marks; return the changed files."""
    changed = [
        (path, new) for path, new in files_of(tables, root) if not path.is_file() or path.read_bytes() != new
    ]
    for path, new in changed:
        write_bytes(path, new)
    return [path for path, _ in changed]
