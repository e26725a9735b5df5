"""Verbs on part schemes (the parts of label images): scheme list, show, new, colours, check."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from cli.console import Json, Overwrite, finish, table
from sensors.files.atomic import check_free, write_bytes

if TYPE_CHECKING:
    from annotate.scheme.scheme import Part, Scheme

app = typer.Typer(help="Schemes: the parts of label images, shipped or your own.", no_args_is_help=True)

NEW_FILE = """\
Scheme of parts; docs/schemes.md describes the fields.
Every region of the body belongs to one part. A part without regions is a thing, such as a wheelchair."""
COLUMNS = ("id", "name", "title", "color", "key", "twin", "regions")


def names() -> list[str]:
    """Return the names of the shipped schemes."""
    from annotate.scheme.scheme_file import SHIPPED

    return [*SHIPPED]


PAPER = "paper"
SchemeName = Annotated[
    str,
    Option(
        help="Scheme of the parts in the labels: shipped name or scheme file (TOML).", autocompletion=names
    ),
]
File = Annotated[Path, Argument(help="Scheme file (TOML).")]


@app.command("list")
def list_(json: Json = False) -> None:
    """List the shipped schemes and their parts."""
    from annotate.scheme.scheme_file import load_scheme

    parts = {name: [part.name for part in load_scheme(name).parts] for name in names()}
    rows = [(name, len(own), ", ".join(own)) for name, own in parts.items()]
    finish({"schemes": parts}, json, table(("name", "parts", "names of parts"), rows))


@app.command()
def show(
    scheme: Annotated[
        str, Argument(help="Name of a shipped scheme, or scheme file (TOML).", autocompletion=names)
    ],
    json: Json = False,
) -> None:
    """Print the parts of a scheme and their regions of the body."""
    from annotate.scheme.scheme_file import load_scheme

    found = load_scheme(scheme)
    parts = [_row(found, part) for part in found.parts]
    neighbours = sorted(sorted(pair) for pair in found.neighbours)
    rows = [[_cell(row[column]) for column in COLUMNS] for row in parts]
    result = {"name": found.name, "parts": parts, "neighbours": neighbours}
    finish(result, json, table(COLUMNS, rows, f"scheme {found.name}: {len(parts)} parts"))


def _row(scheme: "Scheme", part: "Part") -> dict[str, Any]:
    twin = int(scheme.twin_table[part.id])
    regions = [region.label for region in sorted(part.regions)]
    values = (part.id, part.name, part.title, color_text(part.rgb), part.key, twin, regions)
    return dict(zip(COLUMNS, values, strict=True)) | {"twin": twin if twin != part.id else None}


def _cell(value: object) -> object:
    return ", ".join(value) or "free" if isinstance(value, list) else value


def color_text(rgb: tuple[int, int, int]) -> str:
    """Return a colour as ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*rgb)


@app.command()
def new(
    file: Annotated[Path, Argument(help="Scheme file (TOML) to write; its name becomes the scheme's.")],
    start: Annotated[
        str,
        Option("--from", help="Name of a shipped scheme, or scheme file, to copy.", autocompletion=names),
    ] = "paper",
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write a copy of a scheme, as the start of a new scheme."""
    from annotate.scheme.scheme_file import check_scheme_name, load_scheme, scheme_to_toml

    check_free(file, overwrite, suffix=".toml")
    check_scheme_name(file.stem)
    scheme = replace(load_scheme(start), name=file.stem)
    write_bytes(file, scheme_to_toml(scheme, NEW_FILE).encode())
    result = {"scheme": str(file), "parts": len(scheme.parts)}
    finish(result, json, f"{file}: {len(scheme.parts)} parts of {start}; change them, then check the file")


@app.command()
def colours(
    file: File,
    out: Annotated[
        Path | None,
        Option(help="Scheme file to write, without comments.", show_default="only print the colours"),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Propose colours where parts have none or look too similar, also to colour-blind people."""
    from annotate.scheme.colours import with_proposed_colors
    from annotate.scheme.scheme_file import read_draft, scheme_to_toml

    if out is not None:
        check_free(out, overwrite, suffix=".toml")
    draft = read_draft(file)
    scheme = with_proposed_colors(draft.scheme, draft.uncolored)
    pairs = zip(draft.scheme.parts, scheme.parts, strict=True)
    proposed = {
        new.name: color_text(new.rgb) for old, new in pairs if new.rgb != old.rgb or old.id in draft.uncolored
    }
    if out is not None:
        write_bytes(out, scheme_to_toml(scheme).encode())
    written = {} if out is None else {"scheme": str(out)}
    text = table(("part", "proposed color"), proposed.items()) if proposed else f"{file}: colours are apart"
    finish(written | {"colors": proposed}, json, text)


@app.command()
def check(file: File, json: Json = False) -> None:
    """Check a scheme file and print every fault; exit with 1 on a fault."""
    from annotate.scheme.scheme_file import faults_in

    faults = faults_in(file)
    finish({"ok": not faults, "faults": faults}, json, *(faults or [f"{file}: no faults found"]))
    if faults:
        raise typer.Exit(1)
