"""Verbs on devices and what they record: devices, record, repair."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table
from typer import Argument, Option

from cli.console import LINE_SECONDS, Json, Overwrite, cell, finish, say, table
from cli.extras import check_window
from sensors.errors import DeviceError
from sensors.files.atomic import check_free
from sensors.recording.how_tested import KINDS

if TYPE_CHECKING:
    from sensors.recording.recorder import Recorded, Recorder
    from sensors.session.repair import Repaired


def record(
    out: Annotated[Path, Argument(metavar="out.mcap", help="Session to write.")],
    rig: Annotated[Path | None, Option(help="Rig file (TOML): devices and calibration.")] = None,
    device: Annotated[list[str] | None, Option(help="Address, as `devices` lists it; repeatable.")] = None,
    seconds: Annotated[float | None, Option(min=0.1, help="Duration. Default: until Ctrl-C.")] = None,
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
    if preview and infrared:
        raise typer.BadParameter("--preview records people, not the hole plate; leave --infrared out")
    if (rig is None) == (not device):
        raise DeviceError("no device to record from; give either --rig or one or more --device")
    check_free(out, overwrite)
    if preview:
        from annotate.suit.palette import load_suit
        from cli.rig_devices import asked_rig, ended_by_sigterm, open_rig

        asked_rig(rig, device)
        palette = load_suit(suit) if suit else None
        check_window()
        from cli.live_view import look_at

        with ended_by_sigterm(), closing(open_rig(rig, device)) as running:
            look_at(running, palette, out, overwrite, seconds, json)
        return
    from cli.rig_devices import ended_by_sigterm, opened_rig
    from sensors.recording.recorder import Recorder, clock_metadata
    from sensors.session.writer import SessionWriter

    with ended_by_sigterm(), ExitStack() as stack:
        wanted, devices, calibration, _ = opened_rig(rig, device, stack)
        metadata = clock_metadata(devices, wanted.latency_ms)
        writer = SessionWriter(out, calibration, wanted.name, overwrite=overwrite, metadata=metadata)
        recorder = Recorder(devices, writer, infrared)
        with writer, _preview() as show:
            end_s = time.monotonic() + (seconds or math.inf)
            done = recorder.run(lambda: time.monotonic() >= end_s, show)
    _report(out, done, json)


def repair(
    session: Annotated[Path, Argument(help="Recording that was cut off, or a damaged session.")],
    out: Annotated[
        Path | None,
        Option(help="Session to write. Default: NAME.repaired.mcap; NAME.mcap for NAME.mcap.partial."),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write a whole session with every frame of a damaged one that can be read; the damaged one stays."""
    from sensors.session.paths import recording_at
    from sensors.session.repair import repair as repair_session

    done = repair_session(session, out, overwrite=overwrite)
    result = {
        "session": str(done.path),
        "frames": done.frames,
        "lost_frames": done.lost_frames,
        "lost_seconds": round(done.lost_s, 3),
        "lost_bytes": done.lost_bytes,
        "damaged": done.damaged,
        "changed": done.changed,
    }
    finish(result, json, _repaired_text(done, recording_at(session)))


def _repaired_text(done: "Repaired", source: Path) -> str:
    """What was kept, what was left out, and what became of the source."""
    text = f"{done.path} is whole, with {done.frames} frames"
    if not done.changed:
        return text + "; nothing to repair"
    if done.damaged:
        frames = "" if done.lost_frames is None else f", {done.lost_frames} frames"
        text += (
            f"; left out: {done.lost_bytes} bytes at {done.damaged} places{frames}, {cell(done.lost_s, 's')}"
        )
    elif done.lost_frames:
        text += f"; {done.lost_frames} frames are missing"
    else:
        text += "; nothing was lost"
    return text + f"; {source} stays as it is"


@contextmanager
def _preview() -> "Iterator[Callable[[Recorder], None]]":
    """Show the state of the recording once a second; Ctrl-C ends it."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines()
        return
    from rich.live import Live

    with Live(console=console, transient=True, auto_refresh=False) as live:
        yield lambda recorder: live.update(_table(recorder), refresh=True)


def _table(recorder: "Recorder") -> Table:
    table = Table("stream", "images", "a second", "dropped", "now", title="recording; Ctrl-C ends it")
    for name, stream in recorder.streams.items():
        table.add_row(name, str(stream.count), f"{stream.rate_hz:.1f}", str(stream.dropped), stream.shows)
    return table


def _lines() -> "Callable[[Recorder], None]":
    printed = time.monotonic()

    def show(recorder: "Recorder") -> None:
        nonlocal printed
        if time.monotonic() - printed >= LINE_SECONDS:
            printed = time.monotonic()
            parts = (
                f"{name} {stream.rate_hz:.1f}/s, {stream.dropped} dropped, {stream.shows}"
                for name, stream in recorder.streams.items()
            )
            say("; ".join(parts))

    return show


def _report(out: Path, done: "Recorded", json: bool) -> None:
    frames = done.streams["depth"].count
    dropped = sum(stream.dropped for stream in done.streams.values())
    for text, times in done.events.items():
        say(f"{text}" + (f" ({times} times)" if times > 1 else ""))
    result = {
        "frames": frames,
        "dropped": dropped,
        "seconds": round(done.seconds, 2),
        "streams": {
            name: {"count": stream.count, "dropped": stream.dropped} for name, stream in done.streams.items()
        },
        "events": dict(done.events),
        "ended": done.why,
    }
    finish(result, json, f"{frames} frames in {out}, {done.seconds:.1f} s, {dropped} messages dropped")
    if done.why != "asked":
        raise typer.Exit(3)


def devices(json: Json = False) -> None:
    """List connected and virtual devices, and what each kind needs and was tested with."""
    from sensors.recording.open_device import find_devices

    found = find_devices()
    title = "no device is plugged in; virtual devices:" if all(one.virtual for one in found) else ""
    rows = [(one.address, one.serial, one.note) for one in found]
    kinds = [(kind, known.needs.replace("`", ""), known.tested) for kind, known in KINDS.items()]
    title_of_kinds = "what can be connected (no driver has been run on hardware yet):"
    text = table(("address", "serial", "note"), rows, title)
    text += "\n" + table(("kind", "needs", "tested with"), kinds, title_of_kinds)
    answer = {"devices": [asdict(one) for one in found], "kinds": {k: v._asdict() for k, v in KINDS.items()}}
    finish(answer, json, text)
