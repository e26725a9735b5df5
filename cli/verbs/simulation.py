"""The verb ``simulate``: people, or the plate for calibration, on the virtual rig."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from cli.console import Json, Overwrite, finish, progress, say
from cli.extras import needing
from cli.scheme import PAPER, SchemeName
from cli.verbs.rigs import names
from sensors.errors import CloudError
from sensors.files.atomic import check_free
from sensors.session.recording_file import SUFFIX
from synth.data_files import CASTS, TRAINING, Cast, check_choice, table

if TYPE_CHECKING:
    from annotate.scheme.scheme import Scheme
    from annotate.suit.palette import Suit
    from synth.own_camera import OwnCamera
    from synth.rig.film import FilmRig
    from synth.rig.plate_views import PlateViews
    from synth.rig.virtual_rig import VirtualRig

PLATE = "plate"  # in place of a scene: the target of calibrate
RANDOM = "random"  # in place of a palette file: a suit drawn by the seed


def scenes() -> list[str]:
    """Return the names of the virtual rig's scenes, and of the hole plate."""
    from synth.rig.locations import SCENES

    return [*SCENES, PLATE]


def difficulties() -> list[str]:
    """Return the names of the virtual rig's difficulties."""
    return list(table("difficulties"))


def casts() -> list[str]:
    """Return the names of the casts (sets of synthetic people)."""
    return list(CASTS)


CastName = Annotated[
    Cast,
    Option(
        help="training, or judge: people, furniture and rooms to measure on, which no training accepts.",
        autocompletion=casts,
    ),
]
RigName = Annotated[
    str | None,
    Option(
        help="Rig with these cameras; the verb rig lists all.",
        autocompletion=names,
        show_default="kinect2-optris",
    ),
]
CameraFile = Annotated[
    Path | None,
    Option(
        metavar="FILE",
        help='Intrinsics of a depth camera, as for import; the key "sensor" of a JSON file names its faults.',
    ),
]
Difficulty = Annotated[str, Option(help="clean, normal or hard.", autocompletion=difficulties)]


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
            help="sofa, chair, armchair, bed, floor or wheelchair; or plate, the target for calibrate.",
            autocompletion=scenes,
        ),
    ] = "sofa",
    difficulty: Difficulty = "normal",
    rig: RigName = None,
    suit: Annotated[
        str | None,
        Option(
            help="Palette of the suit (TOML); `random` draws one by the seed.",
            show_default="the virtual rig's; drawn by the seed in another scheme than paper",
        ),
    ] = None,
    camera: CameraFile = None,
    cast: CastName = TRAINING,
    scheme: SchemeName = PAPER,
    seed: Annotated[int, Option(help="The same seed gives the same session.", min=0)] = 0,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Record people in a colour-coded suit with the virtual rig; the true labels go to out.truth/."""
    from annotate.scheme.scheme_file import load_scheme
    from sensors.recording.rig_templates import REFERENCE, template_named

    with needing("synth"):
        from synth.rig.plate_views import PlateViews
        from synth.rig.virtual_rig import RigOptions, VirtualRig
    cameras = template_named(rig or REFERENCE)
    check_free(out, overwrite, suffix=SUFFIX)
    check_choice("difficulty", difficulty, difficulties())
    parts, own = load_scheme(scheme), own_camera(camera, f"faults of {cameras.name}'s")
    if own is not None:
        cameras = replace(cameras, calibration=replace(cameras.calibration, depth=own.pinhole))
    if scene == PLATE:
        _check_plate(cast)
        _record_plate(PlateViews(cameras, frames, seed), out, overwrite, json)
        return
    palette = _palette(suit, seed, cast, parts)
    options = RigOptions(scene, rig=cameras.name, suit=palette, cast=cast, scheme=parts, camera=own)
    virtual = VirtualRig(frames, subjects or min(4, frames), difficulty, seed, options)
    record_rig("simulate", virtual, out, overwrite, json)


def own_camera(file: Path | None, unnamed: str) -> "OwnCamera | None":
    """Return the camera in a file, if given, and print what it is. unnamed: as in ``OwnCamera.described``."""
    with needing("synth"):
        from synth.own_camera import read_own_camera
    if file is None:
        return None
    own = read_own_camera(file)
    say(own.described(unnamed))
    return own


def _check_plate(cast: str) -> None:
    if cast != TRAINING:
        raise CloudError(f"scene {PLATE} has no cast; leave out --cast {cast}")


def _record_plate(views: "PlateViews", out: Path, overwrite: bool, json: bool) -> None:
    """Record views of the hole plate with the true calibration, and print their files."""
    from synth.rig.plate_views import record_plate

    with progress("simulate", views.count) as advance:
        truth = record_plate(views, out, advance, overwrite=overwrite)
    result = {"frames": views.count, "truth": str(truth), "suit": None}
    finish(result, json, f"{views.count} views of the hole plate in {out}, the true calibration in {truth}")


def record_rig(title: str, rig: "VirtualRig | FilmRig", out: Path, overwrite: bool, json: bool) -> None:
    """Record a virtual rig with its truth and suit, and print their files."""
    from synth.rig.simulate import simulate, suit_path, truth_path

    with progress(title, len(rig)) as advance:
        simulate(rig, out, advance, overwrite=overwrite)
    frames, truth, suit = len(rig), str(truth_path(out)), str(suit_path(out))
    text = f"{frames} frames in {out}, truth in {truth}, suit in {suit}"
    finish({"frames": frames, "truth": truth, "suit": suit}, json, text)


def _palette(suit: str | None, seed: int, cast: Cast, scheme: "Scheme") -> "Suit | None":
    """Return the palette of a file, or a palette drawn by the seed; None for the virtual rig's own."""
    from annotate.suit.palette import load_suit
    from synth.appearance.random_suit import random_suit

    if suit == RANDOM:
        return random_suit(seed, cast, scheme)
    return load_suit(Path(suit)) if suit else None
