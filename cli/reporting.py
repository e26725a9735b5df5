"""The verb ``report``: results on one page."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from cli.console import Json, Overwrite, finish, provenance
from cli.extras import needing
from eval.compare.results import load_result
from sensors.session.reader import Session


def report(
    results: Annotated[list[Path], Argument(help="Results of 'evaluate --out'; the first is the baseline.")],
    out: Annotated[Path, Option(help="HTML file to write; .csv, .json and .tex are saved beside it.")],
    ceiling: Annotated[
        Path | None, Option(help="Result of one person's corrections against another's.")
    ] = None,
    session: Annotated[
        list[Path] | None, Option(help="Recording of the labels, to show its clouds; repeatable.")
    ] = None,
    history: Annotated[
        list[Path] | None, Option(help="Folder of 'train', to show loss and scores; repeatable.")
    ] = None,
    audit: Annotated[
        list[Path] | None, Option(help="Corrected label set, to show who did what; repeatable.")
    ] = None,
    shown: Annotated[
        list[Path] | None, Option(help="Label set without a truth, to show it; repeatable.")
    ] = None,
    note: Annotated[list[str] | None, Option(help="Text for each --shown, in the same order.")] = None,
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
