"""Verbs on labels: label, suit learn, diff."""

import math
import time
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from annotate.engine import Engine, load_weights
from annotate.label_source import label_source
from annotate.labelset import store
from annotate.labelset.frames import open_frames
from annotate.labelset.store import LabelSet
from annotate.suit.palette import load_suit, suit_to_toml
from cli.console import Json, Overwrite, clear, finish, finish_run, progress, say
from cli.extras import needing
from cli.score_tables import scores_text
from eval.compare.compare import compare_sets
from sensors.files.atomic import check_free, write_bytes
from sensors.importers.open_source import open_source

suit_app = typer.Typer(help="Palettes of the colour-coded suit.", no_args_is_help=True)


def _window(window_c: tuple[float, float] | None) -> tuple[float, float] | None:
    if window_c is None:
        return None
    low, high = window_c
    if not -math.inf < low < high < math.inf:
        raise typer.BadParameter(f"{low} to {high} is not a range; give the lower temperature first")
    return window_c


Window = Annotated[
    tuple[float, float] | None,
    Option(
        help="Lowest and highest temperature of a person, degrees Celsius. Default: found in each frame.",
        callback=_window,
    ),
]
Labels = Annotated[Path, Option(help="Label set to write; an interrupted run continues there.")]


def label(
    session: Annotated[Path, Argument(help="Session, or anything else that import reads.")],
    out: Labels,
    suit: Annotated[Path | None, Option(help="Palette of the colour-coded suit (TOML).")] = None,
    window: Window = None,
    weights: Annotated[
        Path | None, Option(help="Weights from train-labels.", show_default="the shipped ones")
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Fuse the cameras, find the person by temperature, and read the body parts from the suit."""
    palette = load_suit(suit) if suit else None
    engine = Engine(weights=load_weights(weights)) if weights else Engine()
    source = open_source(session)
    clear(out, store.MANIFEST, overwrite, session, *(given for given in (suit, weights) if given))
    notes = [*source.notes, *(palette.notes if palette else ())]
    for note in notes:
        say(note)
    started = time.monotonic()
    with progress("label", len(source)) as advance:
        run = label_source(source, palette, out, advance, window, engine)
    seconds = (time.monotonic() - started) / max(1, len(source))
    review = run.review_order()
    result = {
        "frames": len(run.labels),
        "seconds_per_frame": round(seconds, 4),
        "review": review,
        "notes": notes,
    }
    text = f"{len(run.labels)} frames in {out}, {seconds:.2f} s each; review first: {', '.join(review[:5])}"
    finish_run(result, run, json, text)


@suit_app.command()
def learn(
    out: Annotated[Path, Option(help="Palette (TOML) to write.")],
    labels: Annotated[Path | None, Argument(help="Label set with corrected frames.")] = None,
    session: Annotated[Path | None, Option(help="Recording the labels were made from.")] = None,
    frame: Annotated[
        list[str] | None,
        Option(help="Id of a correctly labelled frame; repeatable. Default: all corrected frames."),
    ] = None,
    swatches: Annotated[
        Path | None,
        Option(
            help="Instead of labels: photograph of the eleven cloths on plain paper, "
            "row by row from the head to the right lower leg."
        ),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Learn the suit's palette from corrected frames, or from a photograph of its cloths."""
    with needing("rig"):
        from annotate.suit.learn import clouds_with, corrected_frames, suit_from_labels, suit_from_photo

    check_free(out, overwrite)
    if swatches is not None and labels is None and session is None and not frame:
        palette = suit_from_photo(swatches, out.stem)
    elif swatches is None and labels is not None and session is not None:
        chosen = LabelSet.open(labels)
        ids = frame or corrected_frames(chosen)
        palette = suit_from_labels(clouds_with(chosen, ids, open_source(session)), out.stem)
    else:
        raise typer.BadParameter("give labels with --session, or --swatches alone")
    write_bytes(out, suit_to_toml(palette).encode())
    for note in palette.notes:
        say(note)
    result = {"suit": str(out), "colors": len(palette.parts), "notes": list(palette.notes)}
    finish(result, json, f"{len(palette.parts)} colours in {out}")


def diff(
    a: Annotated[Path, Argument(help="Label set or dataset.")],
    b: Annotated[Path, Argument(help="Label set or dataset to take as the truth.")],
    json: Json = False,
) -> None:
    """Compare label set A with label set B in a few scores; 'evaluate' computes more scores."""
    sets = open_frames(a), open_frames(b)
    with progress("compare", len(sets[1])) as advance:
        comparison = compare_sets(*sets, advance)
    finish(comparison.to_json(), json, scores_text(comparison, intervals=False))
