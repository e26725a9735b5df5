"""The verb ``train-labels``: train the suit network further on recordings with labels."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from cli.console import Json, Overwrite, check_room, clear, finish, progress
from cli.extras import check_extra, needing
from sensors.errors import CloudError
from sensors.importers.open_source import opener_at

PLAN = "plan.json"
"""First file of a training in its folder."""


def _sources(
    sessions: list[Path], truth: list[Path] | None, suit: Path | None
) -> list[tuple[Path, Path, Path]]:
    """Return recordings with labels and palettes.

    Raises CloudError for too few recordings, for unreadable files, or for labels of the judging cast.
    """
    from annotate.labelset.cast_note import check_trainable
    from annotate.labelset.label_set import LabelSet
    from annotate.suit.palette import load_suit
    from synth.rig.simulate import suit_path, truth_path

    if len(sessions) < 2:
        raise CloudError(
            "one recording is given; give two or more, because confidence is fitted on a held-out one"
        )
    if truth and len(truth) != len(sessions):
        raise CloudError(f"{len(truth)} label sets for {len(sessions)} recordings; give one --truth for each")
    known = truth or [truth_path(session) for session in sessions]
    suits = [suit or suit_path(session) for session in sessions]
    triples = list(zip(sessions, known, suits, strict=True))
    for recording, labels, palette in triples:
        opener_at(recording)
        check_trainable(labels, LabelSet.open(labels).info)
        load_suit(palette)
    return triples


def train_labels(
    sessions: Annotated[list[Path], Argument(help="Two or more recordings of people in the suit.")],
    out: Annotated[
        Path, Option(help="Folder for the suit network, reader.onnx; an interrupted run continues there.")
    ],
    truth: Annotated[
        list[Path] | None,
        Option(
            help="Corrected label set of each recording, in the same order.",
            show_default="the file of simulate beside each",
        ),
    ] = None,
    suit: Annotated[
        Path | None,
        Option(help="Palette of the suit (TOML).", show_default="the file of simulate beside each"),
    ] = None,
    steps: Annotated[
        int,
        Option(min=1, max=1_000_000, help="Steps of eight samples, about half a second each on one core."),
    ] = 1000,
    seed: Annotated[int, Option(min=0, help="The same seed and recordings give the same weights.")] = 0,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Train the suit network further on your recordings, for 'label --weights'. Needs the extra 'train'."""
    check_extra("train", "torch", "onnx", "safetensors")
    triples = _sources(sessions, truth, suit)
    inputs = [path for triple in triples for path in triple]
    check_room(out, PLAN, overwrite, *inputs)
    with needing("train", "synth"):
        from annotate.segmentation.suit_network import SuitNetwork
        from eval.training.segmentation.examples import Recording
        from eval.training.segmentation.train import train_labels
    recordings = [Recording.open(*triple) for triple in triples]
    clear(out, PLAN, overwrite, *inputs)
    done = train_labels(recordings, out, steps, seed, progress)
    result = {
        "weights": str(done.path),
        "sha256": SuitNetwork(done.path).sha256,
        "frames": done.frames,
        "frames_held_out": done.frames_held_out,
        "mean_recall": done.after.recall,
        "person_iou": done.after.person_iou,
        "mean_recall_before": done.before.recall,
        "person_iou_before": done.before.person_iou,
    }
    text = (
        f"{done.path}: {done.frames} frames; on {done.frames_held_out} held out, before borders are drawn, "
        f"mean recall {done.before.recall:.3f} -> {done.after.recall:.3f}, person IoU "
        f"{done.before.person_iou:.3f} -> {done.after.person_iou:.3f}"
    )
    finish(result, json, text)
