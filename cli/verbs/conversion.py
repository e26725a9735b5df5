"""The verb ``convert``: label sets and datasets in another scheme of parts."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from cli.console import Json, Overwrite, finish, progress, say
from cli.scheme import names


def convert(
    labels: Annotated[Path, Argument(help="Label set or dataset.")],
    scheme: Annotated[
        str, Option(help="Scheme of the result: a shipped name or a file.", autocompletion=names)
    ],
    out: Annotated[Path, Option(help="Folder to write.")],
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write a label set or dataset in another scheme, whose parts may join its parts."""
    from annotate.labelset import convert as conversion
    from annotate.labelset.journal import JOURNAL
    from annotate.labelset.labelled_frames import open_frames
    from annotate.scheme.scheme_file import load_scheme

    frames, target = open_frames(labels), load_scheme(scheme)
    with progress("convert", len(frames)) as advance:
        made = conversion.convert(frames, target, out, advance, overwrite=overwrite)
    if (labels / JOURNAL).is_file():
        say(f"{JOURNAL} and the labels before corrections are left out")
    result = {"frames": len(made), "from": frames.scheme.name, "scheme": made.scheme.name, "path": str(out)}
    text = f"{len(made)} frames of scheme {frames.scheme.name} in scheme {made.scheme.name} in {out}"
    finish(result, json, text)
