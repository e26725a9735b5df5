"""Tables of figures as Markdown, written into the pages between their marks."""

import re
from collections.abc import Callable, Iterable
from pathlib import Path

from sensors.files.atomic import write_bytes
from tools.figures.table import ROOT, Measured, Table, changes, load, origin

KINDS = {
    "real": "Recordings of real people",
    "virtual": "Virtual rig",
    "synthetic": "Synthetic images",
}
MARK = re.compile(r"(<!-- figures: (?P<name>[\w-]+) -->\n).*?(<!-- end of figures -->)", re.S)
SOURCES, MOVED = "sources", "moved"
# Marks of the table of tables, and of the figures that moved.


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


def table_block(table: Table, measured: Measured) -> str:
    """Return a table of figures with its source below."""
    rows = (
        [name, *(cells[c].text(spec) if c in cells else "-" for c, spec in table.columns.items())]
        for name, cells in measured.rows.items()
    )
    command = f"`make figures ONLY={table.name}`"
    how = command if measured.product else f"Measured by hand, some on other frames, before {command} did"
    from_ = f"{KINDS[table.kind]}: {table.about} {how}, {origin(measured)}."
    return f"{markdown(['', *table.columns], rows)}\n\n{from_}"


def sources_block(tables: Iterable[Table], all_measured: dict[str, Measured]) -> str:
    """Return the table of tables by kind, with pages and dates."""

    def row(table: Table) -> list[str]:
        found = all_measured.get(table.name)
        pages = ", ".join(f"`{page}`" for page in table.pages)
        minutes = f"{found.cpu_s / 60:.0f}" if found and found.cpu_s else "-"
        when = [origin(found), minutes] if found else ["not yet", "-"]
        return [f"`{table.name}`", table.kind, pages, *when]

    order = sorted(tables, key=lambda table: list(KINDS).index(table.kind))
    return markdown(("table", "kind", "stands in", "measured", "CPU minutes"), map(row, order))


def moved_block(tables: Iterable[Table], all_measured: dict[str, Measured]) -> str:
    """Return the figures that moved since the measurement before."""
    lines, compared = [], 0
    for table in tables:
        if (measured := all_measured.get(table.name)) is None:
            continue
        for row, column, old, new, is_moved in changes(table, measured):
            compared += 1
            if is_moved:
                spec = table.columns[column]
                place = f"`{table.name}`: {row}, {column}"
                lines.append((place, old.text(spec), new.text(spec), measured.before_from))
    said = f"{compared} figures stood here before; {len(lines)} of them have moved by more than chance."
    return f"{said}\n\n{markdown(('figure', 'before', 'now', 'before: measured'), lines)}" if lines else said


def write_pages(tables: list[Table], root: Path = ROOT) -> list[Path]:
    """Write all measured tables into the pages with their marks; return the changed pages."""
    known = {table.name: table for table in tables}
    measured = {name: found for name, table in known.items() if (found := load(table, root / "docs/figures"))}

    def block_of(name: str) -> str | None:
        if name == SOURCES:
            return sources_block(tables, measured)
        if name == MOVED:
            return moved_block(tables, measured)
        return table_block(known[name], measured[name]) if name in measured else None

    written = []
    for page in sorted({page for table in tables for page in table.pages} | {"docs/figures.md"}):
        path = root / page
        before = path.read_text()
        if (after := spliced(before, block_of)) != before:
            write_bytes(path, after.encode())
            written.append(path)
    return written
