"""The verb ``learn``: fine-tune a network on the corrections of labels that the network predicted."""

import os
import time
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from cli.console import Json, finish, progress, say
from cli.extras import check_extra, needing
from sensors.files.atomic import check_there

LOW = 10  # niceness of the process, because other work has priority; untuned


def learn(
    labels: Annotated[Path, Argument(help="Label set with some corrected and accepted frames.")],
    out: Annotated[
        Path, Option(metavar="MODEL", help="Folder for the network; an interrupted run continues there.")
    ],
    session: Annotated[
        Path | None,
        Option(help="Recording of labels made by a suit.", show_default="the one beside the labels"),
    ] = None,
    weights: Annotated[
        Path | None, Option(help="Network (.onnx) to start from.", show_default="the shipped one")
    ] = None,
    json: Json = False,
) -> None:
    """Fine-tune on corrected frames, then label the untouched frames. Needs the extra 'train'.

    With a suit, the suit network is fine-tuned; without one, the network that refines labels by depth. The
    command runs at low priority on one core. A window that starts it takes over the new labels; close other
    windows of the set first.
    """
    from annotate.labelset.label_set import LabelSet

    check_extra("train", "torch", "onnx", "safetensors")
    known = LabelSet.open(labels)
    check_there(*(given for given in (session, weights) if given))
    with needing("train"):
        import torch

        from eval.fine_tuning.fine_tune import check_folder, fine_tune, fine_tuner_of
    check_folder(out)
    os.nice(LOW)
    torch.set_num_threads(1)
    started = time.monotonic()
    done = fine_tune(labels, out, fine_tuner_of(known, session, weights), progress)
    fields = vars(done).items()
    result: dict[str, Any] = {name: str(v) if isinstance(v, Path) else v for name, v in fields}
    gain = f"{done.before:.1%} before, {done.after:.1%} after"
    measured = f"{done.held_out} held out ({', '.join(done.measured_on)})"
    text = f"{done.frames} corrected frames learnt; right on {measured}: {gain}"
    if done.labels is None:
        say(f"no improvement on held-out frames ({gain}), so labels stay; correct more frames")
    else:
        taken = _taken_over(labels, done.labels)
        text += f"; {taken.pop('text')}" if taken else ""
        result |= taken
    result["seconds"] = round(time.monotonic() - started, 1)
    finish(result, json, text)


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
