"""The verb demo: the whole path on the virtual rig."""

import time
from pathlib import Path
from typing import Annotated

from typer import Option

from cli.console import Json, Overwrite, clear, finish, table
from cli.extras import needing
from sensors.files.atomic import check_free, write_bytes

MARKER = ".annotate-cloud-demo"


def demo(
    out: Annotated[Path, Option(help="Folder for all results of the demo.")],
    frames: Annotated[int, Option(min=1, help="Number of frames, of up to four people.")] = 8,
    seed: Annotated[int, Option(min=0, help="The same seed gives the same people and poses.")] = 1,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Run all steps on the virtual rig, from recording to report."""
    check_free(out, overwrite, folder=True)
    with needing("synth", "report"):
        from cli.recipe import whole_path

    started = time.monotonic()
    clear(out, MARKER, overwrite)
    check_free(out, overwrite=False)
    out.mkdir(parents=True)
    write_bytes(out / MARKER, b"")

    answer = whole_path(out, frames, seed)
    answer["seconds"] = round(time.monotonic() - started, 1)
    sets = {"automatic": answer["auto"], "corrected": answer["corrected"], "network": answer["fcn"]}
    rows = [(name, scores["mean_recall"], scores["miou"]) for name, scores in sets.items()]
    scores = table(("labels", "mean recall", "mIoU"), rows)
    finish(answer, json, f"{scores}\n\nreport: {answer['report']}")
