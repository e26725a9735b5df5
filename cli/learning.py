"""The verb that adapts a network to the corrections of a label set."""

import os
import time
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from cli.console import Json, finish, progress, say
from cli.extras import check_extra, needing
from sensors.files.atomic import check_there

LOW = 10
"""How much lower its priority is than that of other work, as a niceness. Chosen by eye."""


def learn(
    labels: Annotated[Path, Argument(help="Label set of which some frames are corrected and accepted.")],
    out: Annotated[
        Path, Option(metavar="MODEL", help="Folder for the network; an interrupted run continues there.")
    ],
    weights: Annotated[
        Path | None, Option(help="Network to start from (.safetensors).", show_default="the shipped one")
    ] = None,
    json: Json = False,
) -> None:
    """Train the network on corrected frames, then label the untouched frames again. Needs the extra 'train'.

    It runs at low priority on one core. If the set is open in a window, the window takes over the new labels.
    """
    from annotate.labelset.store import LabelSet

    check_extra("train", "torch", "onnx", "safetensors")
    LabelSet.open(labels)
    if weights is not None:
        check_there(weights)
    from eval.learning.folder import check_own

    check_own(out)
    with needing("train"):
        import torch

        from eval.learning.learn import images
        from eval.learning.learn import learn as run
        from eval.network.onnx_network import SHIPPED_WEIGHTS
    os.nice(LOW)
    torch.set_num_threads(1)
    started = time.monotonic()
    start = weights or SHIPPED_WEIGHTS.with_suffix(".safetensors")
    with progress("learn, images", images()) as advance:
        done = run(labels, out, start, advance)
    result: dict[str, Any] = {
        "frames": done.frames,
        "held_out": done.held_out,
        "before": done.before,
        "after": done.after,
        "weights": str(done.weights),
        "labels": str(done.labels),
    }
    text = f"{done.frames} corrected frames learnt"
    if done.before is not None and done.after is not None:
        text += f"; right on {done.held_out} held out: {done.before:.1%} before, {done.after:.1%} after"
    if not done.better:
        say("the labels stay: the network is no better on the frames held out; correct more frames")
    else:
        taken = _taken_over(labels, done.labels)
        result |= taken
        text += f"; {taken['text']}" if taken else ""
    result.pop("text", None)
    result["seconds"] = round(time.monotonic() - started, 1)
    finish(result, json, text)


def _taken_over(labels: Path, learnt: Path) -> dict[str, Any]:
    """Give a set the labels that were learnt, as one step; nothing where it is open elsewhere."""
    from annotate.correction.correction import Correction
    from annotate.correction.relabel import relabel
    from annotate.labelset.claim import ClaimedError
    from annotate.labelset.store import LabelSet

    try:
        with Correction.open(labels) as correction:
            step = relabel(correction, LabelSet.open(learnt))
    except ClaimedError:
        say(f"{labels} is open elsewhere: its window takes over the labels, or give the command again later")
        return {}
    return {"relabelled": step.frames, "changed": round(step.changed, 6), "text": step.text}
