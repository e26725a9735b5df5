"""The verb ``report``: results on one page."""

from pathlib import Path
from typing import Annotated

import typer

from cli.console import Json, Overwrite, finish, provenance
from cli.extras import needing
from eval.compare.results import load_result
from sensors.session.reader import Session


def report(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULTS", help="Results that 'evaluate --out' wrote; the first is the baseline."
        ),
    ],
    out: Annotated[Path, typer.Option(help="HTML file to write; .csv, .json and .tex are saved beside it.")],
    ceiling: Annotated[
        Path | None, typer.Option(help="Result of comparing two people's corrections of the same frames.")
    ] = None,
    session: Annotated[
        list[Path] | None,
        typer.Option(help="Recording the labels were made from, to show its clouds; repeatable."),
    ] = None,
    history: Annotated[
        list[Path] | None,
        typer.Option(help="Folder that 'train' wrote, to show loss and scores by epoch; repeatable."),
    ] = None,
    audit: Annotated[
        list[Path] | None, typer.Option(help="Corrected label set, to show who corrected what; repeatable.")
    ] = None,
    shown: Annotated[
        list[Path] | None, typer.Option(help="Label set without a truth, to show its pictures; repeatable.")
    ] = None,
    note: Annotated[
        list[str] | None, typer.Option(help="Text for a --shown label set; one for each, in the same order.")
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write one page with all results beside those of the paper; it opens offline."""
    # These imports take a second, which the other verbs need not spend.
    with needing("report"):
        from eval.report.build import free_outputs, write_report
        from eval.report.gather import gather

    if len(note or []) > len(shown or []):
        raise typer.BadParameter(
            f"{len(note or [])} notes for {len(shown or [])} label sets; give --shown for each"
        )
    free_outputs(out, overwrite)
    notes = [*(note or []), *[""] * len(shown or [])]
    material = gather(
        [load_result(path) for path in results],
        load_result(ceiling) if ceiling else None,
        [Session(path) for path in session or []],
        history or [],
        audit or [],
        dict(zip(shown or [], notes, strict=False)),
        provenance(),
    )
    written = write_report(out, material, overwrite)
    finish({"path": str(out), "files": [str(path) for path in written]}, json, str(out))
