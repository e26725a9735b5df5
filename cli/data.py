"""The verbs ``simulate``, which makes recordings, and ``validate``, which checks whatever holds frames."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from annotate.cloud.fuse import Fuser
from annotate.labelset import dataset, store
from annotate.labelset.dataset import Dataset
from annotate.labelset.store import LabelSet
from cli import names
from cli.console import Json, Overwrite, finish, progress
from cli.extras import needing
from sensors.errors import CloudError
from sensors.importers.open_source import open_source
from sensors.session.reader import Session

Session_ = Annotated[Path, Argument(metavar="out.mcap", help="Session to write.")]
Any_ = Annotated[Path, Argument(help="Session, label set, dataset, motion, or what import reads.")]


def simulate(
    out: Session_,
    frames: Annotated[int, Option(help="Number of frames.", min=1)] = 40,
    subjects: Annotated[
        int | None,
        Option(
            help="Number of people, recorded one after another.",
            min=1,
            show_default="4, at most one per frame",
        ),
    ] = None,
    scene: Annotated[
        str,
        Option(help="sofa, chair or bed; or plate, the target for calibrate.", autocompletion=names.scenes),
    ] = "sofa",
    difficulty: Annotated[
        str, Option(help="clean, normal or hard.", autocompletion=names.difficulties)
    ] = "normal",
    seed: Annotated[int, Option(help="The same seed gives the same session.", min=0)] = 0,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Record people in a colour-coded suit with the virtual rig; the true labels go to out.truth/."""
    if scene == "plate":
        _simulate_plate(out, frames, seed, overwrite, json)
        return
    with needing("synth"):
        from synth.rig.simulate import simulate, suit_path, truth_path
        from synth.rig.virtual_rig import VirtualRig
    rig = VirtualRig(frames, subjects or min(4, frames), difficulty, seed, scene)
    with progress("simulate", frames) as advance:
        simulate(rig, out, advance, overwrite=overwrite)
    result = {"frames": frames, "truth": str(truth_path(out)), "suit": str(suit_path(out))}
    finish(result, json, f"{frames} frames in {out}, truth in {truth_path(out)}, suit in {suit_path(out)}")


def _simulate_plate(out: Path, frames: int, seed: int, overwrite: bool, json: bool) -> None:
    with needing("synth"):
        from synth.cameras.optics import RIG_CALIBRATION
        from synth.rig.plate_views import PlateViews, record_plate

    with progress("simulate", frames) as advance:
        truth = record_plate(PlateViews(RIG_CALIBRATION, frames, seed), out, advance, overwrite=overwrite)
    result = {"frames": frames, "truth": str(truth), "suit": None}
    finish(result, json, f"{frames} views of the hole plate in {out}, the true calibration in {truth}")


def validate(path: Any_, json: Json = False) -> None:
    """Check every frame; exits with 1 if something is wrong."""
    if (path / store.MANIFEST).is_file():
        problems = store.validate(LabelSet.open(path))
    elif (path / dataset.MANIFEST).is_file():
        problems = dataset.validate(Dataset.open(path))
    else:
        problems = _source_problems(path)
    finish(
        {"ok": not problems, "problems": problems}, json, "\n".join(problems) or f"{path}: no problems found"
    )
    if problems:
        raise typer.Exit(1)


def _source_problems(path: Path) -> list[str]:
    source = open_source(path)
    problems = []
    if isinstance(source, Session) and source.truncated:
        problems.append(
            f"{path} is truncated: its end is lost; make its {len(source)} frames a whole session with: "
            f"annotate-cloud repair {source.path}"
        )
    fuser = Fuser(source.calibration)
    try:
        for frame in source:
            if not (frame.depth_mm > 0).any():
                problems.append(f"frame {frame.index:06d} has no depth reading")
                continue
            try:
                fuser.fuse_frame(frame)
            except CloudError as error:
                problems.append(f"frame {frame.index:06d}: {error}")
    except CloudError as error:
        problems.append(str(error))
    return problems
