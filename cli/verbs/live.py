"""The verb ``live``: a running rig or a played session, labelled as it runs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from cli.console import Json, Overwrite
from cli.durations import duration
from cli.extras import check_window
from sensors.errors import DeviceError
from sensors.files.atomic import check_free, check_there
from sensors.importers.open_source import open_source, opener_at
from sensors.session.recording_file import SUFFIX, recording_at

if TYPE_CHECKING:
    from annotate.live.live_frame import Rig


def live(
    session: Annotated[Path | None, Argument(help="Session to play back instead of a rig.")] = None,
    rig: Annotated[Path | None, Option(help="Rig file (TOML): devices and calibration.")] = None,
    device: Annotated[list[str] | None, Option(help="Address, as `devices` lists it; repeatable.")] = None,
    suit: Annotated[
        Path | None, Option(help="Palette of the suit (TOML). Default: parts from the network.")
    ] = None,
    weights: Annotated[
        Path | None, Option(help="Network (.onnx), from adapt for instance.", show_default="the shipped one")
    ] = None,
    record: Annotated[Path | None, Option(help="Session to record from the start.")] = None,
    subject: Annotated[str, Option(help="Name of the person, for the recording.")] = "",
    no_window: Annotated[
        bool, Option("--no-window", help="Print joints as JSON lines instead; for a robot without a screen.")
    ] = False,
    serve: Annotated[
        bool, Option("--serve", help="Also stream to Foxglove on this machine (extra foxglove).")
    ] = False,
    port: Annotated[int, Option(help="Port of --serve; 0 takes a free port.", min=0, max=65535)] = 8765,
    seconds: Annotated[
        float | None, Option(min=0.1, callback=duration, help="Duration. Default: until Ctrl-C.")
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Label a running rig live, or play a session; show parts, joints, and warnings about the rig."""
    from annotate.suit.palette import load_suit
    from cli.live_view import LiveOptions, watch
    from cli.rig_devices import check_one_source, open_rig, rig_of
    from sensors.recording.playback import Playback

    check_one_source(session=session, rig=rig, device=device)
    if session is not None:
        if record is not None:
            raise DeviceError(f"{session} is played back, which cannot be recorded; leave out --record")
        check_there(recording_at(session))
        opener_at(session)
    else:
        rig_of(rig, device)
    if record is not None:
        check_free(record, overwrite, suffix=SUFFIX)
    if weights is not None:
        check_there(weights)
    palette = load_suit(suit) if suit else None
    if not no_window:
        check_window()

    def open_one() -> "Rig":
        return open_rig(rig, device) if session is None else Playback(open_source(session))

    served = port if serve else None
    options = LiveOptions(palette, record, subject, seconds, overwrite, json, not no_window, served, weights)
    watch(open_one, options)
