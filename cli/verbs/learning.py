"""The verb that adapts what labelled a set to its corrections."""

import os
import time
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from cli.console import Json, finish, progress, say
from cli.extras import check_extra, needing
from sensors.files.atomic import check_there

LOW = 10
"""Niceness of the learning process: other work has priority. Untuned."""


def learn(
    labels: Annotated[Path, Argument(help="Label set of which some frames are corrected and accepted.")],
    out: Annotated[
        Path, Option(metavar="MODEL", help="Folder for the network; an interrupted run continues there.")
    ],
    session: Annotated[
        Path | None,
        Option(help="Recording, of labels read from a suit.", show_default="the one beside them"),
    ] = None,
    weights: Annotated[
        Path | None,
        Option(
            help="Reader (.onnx) to start from.",
            show_default="the shipped one",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Learn from corrected frames, then label the untouched frames again. Needs the extra 'train'.

    The reader of suits learns; without a suit it reads depth and the labels there are. At low priority on
    one core.
    If the set is open in a window, the window takes over the new labels.
    """
    from annotate.labelset.label_set import LabelSet

    check_extra("train", "torch", "onnx", "safetensors")
    known = LabelSet.open(labels)
    check_there(*(given for given in (session, weights) if given))
    from eval.fine_tuning.folder import check_own

    check_own(out)
    with needing("train"):
        import torch

        from eval.fine_tuning.fine_tune import learn as run
        from eval.fine_tuning.fine_tune import learner_of
    os.nice(LOW)
    torch.set_num_threads(1)
    started = time.monotonic()
    done = run(labels, out, learner_of(known, session, weights), progress)
    fields = vars(done).items()
    result: dict[str, Any] = {name: str(v) if isinstance(v, Path) else v for name, v in fields}
    text = (
        f"{done.frames} corrected frames learnt; right on {done.held_out} held out "
        f"({', '.join(done.measured_on)}): "
        f"{done.before:.1%} before, {done.after:.1%} after"
    )
    if done.labels is None:
        gain = f"{done.before:.1%} before, {done.after:.1%} after"
        say(f"no improvement on held-out frames ({gain}), so labels stay; correct more frames")
    else:
        taken = _taken_over(labels, done.labels)
        text += f"; {taken.pop('text')}" if taken else ""
        result |= taken
    result["seconds"] = round(time.monotonic() - started, 1)
    finish(result, json, text)


def _taken_over(labels: Path, learnt: Path) -> dict[str, Any]:
    """Give a set the labels that were learnt, as one step; nothing where it is open elsewhere."""
    from annotate.correction.correction import Correction
    from annotate.correction.relabel import relabel
    from annotate.labelset.claim import ClaimedError
    from annotate.labelset.label_set import LabelSet

    try:
        with Correction.open(labels) as correction:
            step = relabel(correction, LabelSet.open(learnt))
    except ClaimedError:
        say(f"{labels} is open elsewhere: its window takes over the labels, or give the command again later")
        return {}
    return {"relabelled": step.frames, "changed": round(step.changed, 6), "text": step.text}
