"""The verb ``train-labels``: fit the labelling engine to another suit or rig."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from cli.console import Json, Overwrite, clear, finish, progress
from cli.extras import needing
from sensors.errors import CloudError


def train_labels(
    sessions: Annotated[list[Path], Argument(help="Two or more recordings of people in the suit.")],
    out: Annotated[Path, Option(help="Folder for weights.npz; an interrupted run continues there.")],
    truth: Annotated[
        list[Path] | None,
        Option(
            help="Corrected label set of each recording, in the same order.",
            show_default="what simulate wrote beside each",
        ),
    ] = None,
    suit: Annotated[
        Path | None,
        Option(help="Palette of the suit (TOML).", show_default="what simulate wrote beside each"),
    ] = None,
    seed: Annotated[int, Option(min=0, help="The same seed and recordings give the same weights.")] = 0,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Fit the labelling to another suit or rig, for 'label --weights'. Needs the extra 'train'."""
    with needing("train", "synth"):
        from eval.training.engine_data import Recording
        from eval.training.fit_engine import PLAN, train_labels
        from synth.rig.simulate import suit_path, truth_path
    if truth and len(truth) != len(sessions):
        raise CloudError(f"{len(truth)} label sets for {len(sessions)} recordings; give one --truth for each")
    known = truth or [truth_path(session) for session in sessions]
    suits = [suit or suit_path(session) for session in sessions]
    triples = list(zip(sessions, known, suits, strict=True))
    clear(out, PLAN, overwrite, *(path for triple in triples for path in triple))
    done = train_labels([Recording.open(*triple) for triple in triples], out, seed, progress)
    result = {
        "weights": str(done.path),
        "sha256": done.weights.sha256(),
        "frames": done.frames,
        "frames_held_out": done.frames_held_out,
        "mean_recall": done.figures.recall,
        "person_iou": done.figures.person_iou,
    }
    text = (
        f"{done.path}: {done.frames} frames; on {done.frames_held_out} held out mean recall "
        f"{done.figures.recall:.3f}, person IoU {done.figures.person_iou:.3f}"
    )
    finish(result, json, text)
