"""The verb ``simulate``: people, or the plate for calibration, before the virtual rig."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from cli.console import Json, Overwrite, finish, progress
from cli.extras import needing
from cli.verbs.rigs import names
from sensors.files.atomic import check_free
from synth.choices import DIFFICULTIES, SCENES, check_rig

if TYPE_CHECKING:
    from annotate.suit.palette import Suit
    from sensors.recording.rig_templates import RigTemplate

PLATE = "plate"
"""In place of a scene: the target of calibrate."""
RANDOM = "random"
"""In place of a palette file: a suit drawn by the seed."""


def scenes() -> list[str]:
    """Scenes of the virtual rig, and the plate for calibration."""
    return [*SCENES, PLATE]


def difficulties() -> list[str]:
    """Difficulties of the virtual rig."""
    return list(DIFFICULTIES)


def simulate(
    out: Annotated[Path, Argument(metavar="out.mcap", help="Session to write.")],
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
        Option(
            help="sofa, chair, bed or floor; or plate, the target for calibrate.",
            autocompletion=scenes,
        ),
    ] = "sofa",
    difficulty: Annotated[str, Option(help="clean, normal or hard.", autocompletion=difficulties)] = "normal",
    rig: Annotated[
        str | None,
        Option(
            help="Which cameras; the verb rig lists them.",
            autocompletion=names,
            show_default="kinect2-optris",
        ),
    ] = None,
    suit: Annotated[
        str | None,
        Option(
            help="Palette of the suit (TOML); `random` draws one by the seed.",
            show_default="the virtual rig's",
        ),
    ] = None,
    seed: Annotated[int, Option(help="The same seed gives the same session.", min=0)] = 0,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Record people in a colour-coded suit with the virtual rig; the true labels go to out.truth/."""
    from sensors.recording.rig_templates import REFERENCE, template_named

    cameras = template_named(rig or REFERENCE)
    check_free(out, overwrite)
    if scene == PLATE:
        _simulate_plate(out, frames, seed, cameras, overwrite, json)
        return
    count = subjects or min(4, frames)
    check_rig(frames, count, scene, difficulty)
    worn = _worn(suit, seed)
    with needing("synth"):
        from synth.rig.paths import suit_path, truth_path
        from synth.rig.simulate import simulate
        from synth.rig.virtual_rig import VirtualRig
    virtual = VirtualRig(frames, count, difficulty, seed, scene, rig=cameras.name, suit=worn)
    with progress("simulate", frames) as advance:
        simulate(virtual, out, advance, overwrite=overwrite)
    result = {"frames": frames, "truth": str(truth_path(out)), "suit": str(suit_path(out))}
    finish(result, json, f"{frames} frames in {out}, truth in {truth_path(out)}, suit in {suit_path(out)}")


def _worn(suit: str | None, seed: int) -> "Suit":
    """The palette of a file, drawn by the seed, or the virtual rig's own."""
    from annotate.suit.palette import DEFAULT_SUIT, load_suit

    if suit != RANDOM:
        return load_suit(Path(suit)) if suit else DEFAULT_SUIT
    with needing("synth"):
        from synth.appearance.random_suit import random_suit
    return random_suit(seed)


def _simulate_plate(
    out: Path, frames: int, seed: int, rig: "RigTemplate", overwrite: bool, json: bool
) -> None:
    with needing("synth"):
        from synth.rig.plate_views import PlateViews, record_plate

    with progress("simulate", frames) as advance:
        truth = record_plate(PlateViews(rig, frames, seed), out, advance, overwrite=overwrite)
    result = {"frames": frames, "truth": str(truth), "suit": None}
    finish(result, json, f"{frames} views of the hole plate in {out}, the true calibration in {truth}")
