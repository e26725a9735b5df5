"""Verbs on devices and recordings: devices, record, repair, strip."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table
from typer import Argument, Option

from cli.console import LINE_SECONDS, Json, Overwrite, cell, event_lines, finish, progress, say, table
from cli.durations import duration
from cli.extras import check_window
from sensors.device.address import KINDS
from sensors.files.atomic import check_free, check_there
from sensors.interrupt import Ending, ended_by_signals, interrupted_by_signals
from sensors.session.recording_file import SUFFIX

if TYPE_CHECKING:
    from sensors.recording.live_rig import LiveRig
    from sensors.recording.stream_health import Health
    from sensors.session.reader import Session
    from sensors.session.repair import Repaired
    from sensors.session.strip import Blur

CHECK_S = 1.0  # s between two checks of a recording's state; untuned


def record(
    out: Annotated[Path, Argument(metavar="out.mcap", help="Session to write.")],
    rig: Annotated[Path | None, Option(help="Rig file (TOML): devices and calibration.")] = None,
    device: Annotated[list[str] | None, Option(help="Address, as `devices` lists it; repeatable.")] = None,
    seconds: Annotated[
        float | None, Option(min=0.1, callback=duration, help="Duration. Default: until Ctrl-C.")
    ] = None,
    infrared: Annotated[
        bool, Option("--infrared", help="Record infrared images too, for calibrate.")
    ] = False,
    preview: Annotated[
        bool, Option("--preview", help="Show the window of `live`; closing it ends the recording.")
    ] = False,
    suit: Annotated[Path | None, Option(help="Palette of the suit (TOML), for --preview.")] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Record depth, colour and temperature from devices, real or virtual, into a session."""
    from annotate.suit.palette import load_suit
    from cli.rig_devices import open_rig, rig_of

    if preview and infrared:
        raise typer.BadParameter("--preview records people, not the hole plate; leave out --infrared")
    if suit is not None and not preview:
        raise typer.BadParameter("needs --preview; a recording has no palette", param_hint="--suit")
    rig_of(rig, device)
    check_free(out, overwrite, suffix=SUFFIX)
    palette = load_suit(suit) if suit else None
    if preview:
        check_window()
    with interrupted_by_signals(), closing(open_rig(rig, device)) as running, ended_by_signals() as ending:
        if preview:
            from cli.live_view import LiveOptions, show_window

            options = LiveOptions(palette, out, "", seconds, overwrite, json)
            show_window(running, options, ending)
            return
        running.record(out, overwrite=overwrite, infrared=infrared)
        why = _run(running, time.monotonic() + (seconds or math.inf), ending)
    _report(running, why, json)


def _run(running: "LiveRig", end_s: float, ending: Ending) -> str:
    """Record until the time is over, a signal comes or the recording ends; return the reason."""
    from annotate.live.rig_warnings import rig_warnings
    from annotate.live.warning import ActiveWarnings

    active, printed = ActiveWarnings(), set[str]()
    with _preview() as show:
        running.start()
        checked_s = time.monotonic()
        while not ending.asked and time.monotonic() < end_s and not running.frames.ended:
            time.sleep(0.02)
            if time.monotonic() - checked_s < CHECK_S:
                continue
            checked_s, health = time.monotonic(), running.health()
            if health.recording is None:
                break
            warnings = active.update(rig_warnings(health), checked_s)
            say(*(warning.text for warning in warnings if warning.kind not in printed))
            printed = {warning.kind for warning in warnings}
            show(health)
    running.close()
    if running.error is not None:
        raise running.error
    health, take = running.health(), running.last_take
    if take is not None and not take.frames:
        return "nothing"
    if health.trouble:
        return "disk"
    return "lost" if health.streams["depth"].away else "asked"


@contextmanager
def _preview() -> "Iterator[Callable[[Health], None]]":
    """Yield a function that shows the state of the recording: as a table, or as lines without a terminal."""
    console, printed = Console(stderr=True), time.monotonic()
    if console.is_terminal:
        from rich.live import Live

        with Live(console=console, transient=True, auto_refresh=False) as live:
            yield lambda health: live.update(_table(health), refresh=True)
        return

    def show(health: "Health") -> None:
        nonlocal printed
        if time.monotonic() - printed >= LINE_SECONDS:
            printed = time.monotonic()
            streams = health.streams.items()
            say("; ".join(f"{n} {s.rate_hz:.1f}/s, {s.dropped} dropped, {s.shows}" for n, s in streams))

    yield show


def _table(health: "Health") -> Table:
    table = Table("stream", "images", "a second", "dropped", "now", title="recording; Ctrl-C ends it")
    for name, stream in health.streams.items():
        table.add_row(name, str(stream.count), f"{stream.rate_hz:.1f}", str(stream.dropped), stream.shows)
    return table


def _report(running: "LiveRig", why: str, json: bool) -> None:
    health, take = running.health(), running.last_take
    events, seconds = (dict(take.events), take.seconds) if take else ({}, 0.0)
    frames = take.frames if take else 0
    where = f" in {take.path}" if take and take.path.exists() else ""
    say(*event_lines(events))
    result = {
        "frames": frames,
        "dropped": health.dropped,
        "seconds": round(seconds, 2),
        "streams": {
            name: {"count": stream.count, "dropped": stream.dropped, "left_out": stream.left_out}
            for name, stream in health.streams.items()
        },
        "events": events,
        "ended": why,
    }
    text = f"{frames} frames{where}, {seconds:.1f} s, {health.dropped} messages dropped"
    finish(result, json, text)
    if health.trouble:
        say(health.trouble)
    if why != "asked":
        raise typer.Exit(3)


def repair(
    session: Annotated[Path, Argument(help="Recording that was cut off, or a damaged session.")],
    out: Annotated[
        Path | None,
        Option(help="Session to write. Default: NAME.repaired.mcap; NAME.mcap for NAME.mcap.partial."),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Copy every readable frame of a damaged session into a new session; keep the damaged session."""
    from sensors.session.recording_file import recording_at
    from sensors.session.repair import repair as repair_session

    source = recording_at(session)
    done = repair_session(source, out, overwrite=overwrite)
    names = ("frames", "lost_frames", "lost_bytes", "damaged", "changed")
    result = {"session": str(done.path), **{name: getattr(done, name) for name in names}}
    finish({**result, "lost_seconds": round(done.lost_s, 3)}, json, _repaired_text(done, source))


def _repaired_text(done: "Repaired", source: Path) -> str:
    """Return a sentence about kept and lost frames and the damaged file."""
    text = f"{done.path} is whole, with {_count(done.frames, 'frame')}"
    if not done.changed:
        return text + "; nothing to repair"
    lost = "" if done.lost_frames is None else f", {_count(done.lost_frames, 'frame')}"
    if done.damaged:
        where = _count(done.damaged, "place")
        text += f"; left out: {_count(done.lost_bytes, 'byte')} at {where}{lost}, {cell(done.lost_s, 's')}"
    else:
        text += f"; missing{lost[1:]}" if done.lost_frames else "; nothing was lost"
    return text + f"; {source} stays as it is"


def _count(number: int, name: str) -> str:
    return f"{number} {name}" + ("" if number == 1 else "s")


def strip(
    session: Annotated[Path, Argument(help="Session to copy.")],
    out: Annotated[Path, Argument(metavar="out.mcap", help="Session to write.")],
    colour: Annotated[
        bool, Option("--colour", help="Leave out colour and infrared images, which show faces.")
    ] = False,
    thermal: Annotated[bool, Option("--thermal", help="Leave out temperatures.")] = False,
    faces: Annotated[
        Path | None,
        Option(
            metavar="LABELS",
            help="Blur the heads of this label set, or of this pose file (people.json), in colour images; "
            "leave out images without a known head, and infrared images.",
        ),
    ] = None,
    subject: Annotated[
        str, Option(metavar="NAME", help="Remove this name from all texts.", show_default="no name")
    ] = "",
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Copy a session without what the options name; the copy is whole, and the session stays as it is."""
    from sensors.session.messages import INFRARED
    from sensors.session.reader import Session
    from sensors.session.strip import COLOURS, TEMPERATURES, Removal
    from sensors.session.strip import strip as strip_session

    if not (colour or thermal or faces or subject):
        raise typer.BadParameter("give --colour, --thermal, --faces or --subject")
    if colour and faces:
        raise typer.BadParameter("--colour leaves no image for --faces; give one of the two")
    check_there(session, *([faces] if faces else []))
    source = Session(session)
    topics = (COLOURS if colour else frozenset()) | (TEMPERATURES if thermal else frozenset())
    blur = _blur(source, faces) if faces else None
    removal = Removal(topics | ({INFRARED} if faces else frozenset()), subject, blur)
    with progress("strip, frames", len(source)) as advance:
        done = strip_session(session, out, removal, advance, overwrite=overwrite)
    left_out = {topic: count for topic, count in sorted(done.left_out.items()) if count}
    text = f"{done.frames} frames in {out}"
    if left_out:
        text += "; left out: " + ", ".join(f"{count} of {topic}" for topic, count in left_out.items())
    finish({"frames": done.frames, "left_out": left_out, "session": str(out)}, json, text)


def _blur(source: "Session", faces: Path) -> "Blur":
    from annotate.faces import FaceBlur, heads_of

    return FaceBlur(source, heads_of(faces, source))


def devices(json: Json = False) -> None:
    """List connected and virtual devices, and the needs and tests of each kind."""
    from sensors.recording.open_device import find_devices

    found = find_devices()
    title = "no device is plugged in; virtual devices:" if all(one.virtual for one in found) else ""
    rows = [(one.address, one.serial, one.note) for one in found]
    kinds = [(kind, known.needs.replace("`", ""), known.tested) for kind, known in KINDS.items()]
    title_of_kinds = "what can be connected (no driver has been run on hardware yet):"
    connected = table(("address", "serial", "note"), rows, title)
    known = table(("kind", "needs", "tested with"), kinds, title_of_kinds)
    answer = {"devices": [asdict(one) for one in found], "kinds": {k: v._asdict() for k, v in KINDS.items()}}
    finish(answer, json, connected, known)
