"""Verbs on labels: label, diff."""

import math
import time
from pathlib import Path
from typing import Annotated

import typer

from annotate import store
from annotate.label import label_source
from annotate.person import WINDOW_C
from annotate.store import LabelSet
from annotate.suit import load_suit
from cli.console import Json, Overwrite, clear, finish, finish_run, progress, say
from eval.compare import compare_sets
from sensors.importers import open_source


def _window(window_c: tuple[float, float]) -> tuple[float, float]:
    low, high = window_c
    if not -math.inf < low < high < math.inf:
        raise typer.BadParameter(f"{low} to {high} is no range; give the lower temperature first")
    return window_c


Window = Annotated[
    tuple[float, float], typer.Option(help="Temperatures of a person, degrees Celsius.", callback=_window)
]
Labels = Annotated[Path, typer.Option(help="Label set to write; a broken run goes on there.")]


def label(
    session: Annotated[Path, typer.Argument(help="Session, folder of depth PNGs, PCD or PLY.")],
    out: Labels,
    suit: Annotated[Path | None, typer.Option(help="Palette of the colour-coded suit (TOML).")] = None,
    window: Window = WINDOW_C,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Fuse every frame, extract the person by temperature, and read the parts off the suit."""
    palette = load_suit(suit) if suit else None
    source = open_source(session)
    clear(out, store.MANIFEST, overwrite, session, *([suit] if suit else []))
    for note in source.notes:
        say(note)
    started = time.monotonic()
    with progress("label", len(source)) as advance:
        run = label_source(source, palette, out, advance, window)
    seconds = (time.monotonic() - started) / max(1, len(source))
    review = run.review_order()
    result = {
        "frames": len(run.labels),
        "seconds_per_frame": round(seconds, 4),
        "review": review,
        "notes": list(source.notes),
    }
    text = f"{len(run.labels)} frames in {out}, {seconds:.2f} s each; review first: {', '.join(review[:5])}"
    finish_run(result, run, json, text)


def diff(
    a: Annotated[Path, typer.Argument(metavar="A", help="Label set.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Label set taken as the truth.")],
    json: Json = False,
) -> None:
    """Compare label set A with label set B."""
    result = compare_sets(LabelSet.open(a), LabelSet.open(b)).to_json()
    finish(result, json, "\n".join(f"{key}: {value}" for key, value in result.items()))
