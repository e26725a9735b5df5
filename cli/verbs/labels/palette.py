"""Verb ``suit learn``: write the palette of a suit."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from cli.console import Json, Overwrite, finish, say
from cli.scheme import PAPER
from sensors.files.atomic import check_free, check_there, write_bytes
from sensors.importers.open_source import open_source

suit_app = typer.Typer(help="Palettes of the colour-coded suit.", no_args_is_help=True)


@suit_app.command()
def learn(
    out: Annotated[Path, Option(help="Palette (TOML) to write.")],
    labels: Annotated[Path | None, Argument(help="Label set with corrected frames.")] = None,
    session: Annotated[Path | None, Option(help="Recording from which the labels were made.")] = None,
    frame: Annotated[
        list[str] | None,
        Option(help="Id of a correctly labelled frame; repeatable. Default: all corrected frames."),
    ] = None,
    swatches: Annotated[
        Path | None,
        Option(
            help="Instead of labels: photograph of the suit's cloths on plain paper, "
            "row by row in the order of the scheme's parts."
        ),
    ] = None,
    scheme: Annotated[
        Path | None,
        Option(help="Scheme of the photographed cloths, name or file (TOML).", show_default="paper"),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Learn the suit's palette, in the scheme of corrected frames, or from a photograph of its cloths."""
    from annotate.labelset.label_set import LabelSet
    from annotate.scheme.scheme_file import load_scheme
    from annotate.suit.palette import suit_to_toml
    from annotate.suit.palette_learning import (
        clouds_with,
        corrected_frames,
        suit_from_labels,
        suit_from_photo,
    )

    check_free(out, overwrite, suffix=".toml")
    if swatches is not None and labels is None and session is None and not frame:
        check_there(swatches)
        palette = suit_from_photo(swatches, out.stem, load_scheme(str(scheme or PAPER)))
    elif swatches is None and scheme is None and labels is not None and session is not None:
        chosen, source = LabelSet.open(labels), open_source(session)
        ids = frame or corrected_frames(chosen)
        palette = suit_from_labels(clouds_with(chosen, ids, source), out.stem, chosen.scheme)
    else:
        raise typer.BadParameter("give labels with --session, or --swatches with or without --scheme")
    write_bytes(out, suit_to_toml(palette).encode())
    say(*palette.notes)
    result = {"suit": str(out), "colors": len(palette.parts), "notes": list(palette.notes)}
    finish(result, json, f"{len(palette.parts)} colours in {out}")
