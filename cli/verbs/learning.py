"""The verbs ``learn`` and ``adapt``: fine-tune networks on corrections, and on labelled recordings."""

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, BadParameter, Option

from cli.console import Json, Overwrite, check_room, clear, finish, progress, say
from cli.durations import duration
from cli.extras import check_extra, needing
from sensors.errors import CloudError
from sensors.files.atomic import check_there

if TYPE_CHECKING:
    from eval.fine_tuning.adaptation.adapt import Adapted

LOW = 10  # niceness of the process, because other work has priority; untuned


def learn(
    labels: Annotated[Path, Argument(help="Label set with some corrected and accepted frames.")],
    out: Annotated[
        Path | None,
        Option(metavar="MODEL", help="Folder for the network; an interrupted run continues there."),
    ] = None,
    session: Annotated[
        Path | None,
        Option(help="Recording of labels made by a suit.", show_default="the one beside the labels"),
    ] = None,
    weights: Annotated[
        Path | None, Option(help="Network (.onnx) to start from.", show_default="the shipped one")
    ] = None,
    undo: Annotated[
        bool, Option("--undo", help="Restore the labels from before the last fine-tuning instead.")
    ] = False,
    json: Json = False,
) -> None:
    """Fine-tune on corrected frames, then label the untouched frames. Needs the extra 'train'.

    With a suit, the suit network is fine-tuned; without one, the network that refines labels by depth. Labels
    stay unless the gain on corrected frames that the network has not seen is certain. The command runs at
    low priority on one core. A window that starts it takes over the new labels; close other windows of the
    set first.
    """
    from annotate.labelset.atomic_folder import check_outside
    from annotate.labelset.label_set import LabelSet

    if undo:
        _undo(labels, json)
        return
    if out is None:
        raise BadParameter("give --out MODEL, a folder for the network; or --undo")
    check_extra("train", "torch", "onnx", "safetensors")
    known = LabelSet.open(labels)
    check_there(*(given for given in (session, weights) if given))
    with needing("train"):
        import torch

        from eval.fine_tuning.fine_tune import check_folder, fine_tune, fine_tuner_of
    check_folder(out)
    check_outside(out, labels)
    os.nice(LOW)
    torch.set_num_threads(1)
    started = time.monotonic()
    done = fine_tune(labels, out, fine_tuner_of(known, session, weights), progress)
    frames = ", ".join(done.measured_on)
    text = f"{len(done.measured_on)} corrected frames, each held out once ({frames}): {done.gain.text}"
    if done.labels is None:
        text += f"; {labels} keeps its labels, because no gain is certain; correct more frames"
    result = done.fields() | {"seconds": round(time.monotonic() - started, 1)}
    if done.labels is not None and (taken := _taken_over(labels, done.labels)):
        text += f"; {taken.pop('text')}"
        result |= taken
    finish(result, json, text)


def adapt(
    labels: Annotated[
        list[Path],
        Argument(help="Label sets of label by suit or colour, or accepted frames of predict."),
    ],
    out: Annotated[Path, Option(help="Folder for the network; an interrupted run continues there.")],
    minutes: Annotated[float, Option(min=0.1, callback=duration, help="How long to train.")] = 10.0,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Fine-tune the depth network on labelled recordings. Needs the extra 'train'.

    Holds out people, recordings or spans; writes no network without a certain gain there. Also trains on
    synthetic people, so that less is forgotten.
    """
    check_there(*labels)
    started = time.monotonic()
    done = adapted(labels, out, minutes, overwrite)
    finish(done.fields() | {"seconds": round(time.monotonic() - started, 1)}, json, adapted_text(done))


def adapted(labels: Sequence[Path], out: Path, minutes: float, overwrite: bool = False) -> "Adapted":
    """Fine-tune the depth network on label sets into the folder ``out``, with progress."""
    from annotate.labelset.atomic_folder import check_outside

    check_extra("train", "torch", "onnx", "safetensors")
    with needing("train"):
        from eval.fine_tuning.adaptation.adapt import ORDER
        from eval.fine_tuning.adaptation.adapt import adapt as run
        from eval.fine_tuning.adaptation.labelled_people import check_sets, taught_frames
    sets = [taught_frames(path) for path in labels]
    check_sets(sets)
    check_outside(out, *labels)
    check_room(out, ORDER, overwrite, *labels)
    clear(out, ORDER, overwrite, *labels)
    return run(sets, out, minutes, progress)


def adapted_text(done: "Adapted") -> str:
    """Return the gain, and what follows from it."""
    if done.weights is None:
        why = "no gain is certain" if done.gain.is_harmless else "a score falls"
        return f"{done.gain.text}; no network is written, because {why}; label more recordings"
    return f"{done.gain.text}; use predict or live --weights {done.weights}"


def _undo(labels: Path, json: bool) -> None:
    """Take back the last fine-tuning in frames without later work of a person."""
    from annotate.correction.correction import Correction
    from annotate.correction.relabel import take_back

    with Correction.open(labels) as correction:
        done = take_back(correction)
    if done is None:
        raise CloudError(f"{labels} has no labels of learn; there is nothing to take back")
    finish({"restored": done.frames}, json, done.text_of_taking_back)


def _taken_over(labels: Path, learnt: Path) -> dict[str, Any]:
    """Write new labels into a label set as one step of its journal; return JSON values, none if the set is
    open elsewhere.
    """
    from annotate.correction.correction import Correction
    from annotate.correction.relabel import relabel
    from annotate.labelset.claim import ClaimedError
    from annotate.labelset.label_set import LabelSet

    try:
        with Correction.open(labels) as correction:
            step = relabel(correction, LabelSet.open(learnt))
    except ClaimedError:
        say(
            f"{labels} is open elsewhere; take over the labels in that window, or run the command again later"
        )
        return {}
    return {"relabelled": step.frames, "changed": round(step.changed, 6), "text": step.text}
