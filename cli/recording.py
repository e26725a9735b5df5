"""Verbs on devices and what they record: devices, record, repair."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.live import Live
from rich.table import Table
from typer import Argument, Option

from cli.console import LINE_SECONDS, Json, Overwrite, cell, finish, say, table
from cli.extras import needing
from sensors.device.protocol import Device
from sensors.errors import CalibrationError, DeviceError
from sensors.recording.how_tested import KINDS
from sensors.recording.live_rig import LiveRig
from sensors.recording.open_device import find_devices, open_device
from sensors.recording.recorder import Recorded, Recorder, clock_metadata
from sensors.recording.rig_file import RecordingRig, load_rig
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.repair import repair as repair_session
from sensors.session.writer import SessionWriter

VIRTUAL_SEED = 7
VIRTUAL_FRAMES = 30
"""One second of the virtual rig at 30 frames a second, which the virtual cameras repeat."""


class Shown:
    """The frames of the virtual cameras, rendered when the first of them is read."""

    def __init__(self) -> None:
        with needing("synth"):
            from synth.rig.virtual_rig import VirtualRig
        self._rig = VirtualRig(VIRTUAL_FRAMES, 1, "normal", VIRTUAL_SEED, frames_per_second=VIRTUAL_FRAMES)
        self.calibration = self._rig.calibration

    def __iter__(self) -> Iterator[RigFrame]:
        return iter(self._frames)

    @cached_property
    def _frames(self) -> tuple[RigFrame, ...]:
        say(f"rendering {VIRTUAL_FRAMES} frames for the virtual cameras")
        return tuple(self._rig)


def record(
    out: Annotated[Path, Argument(metavar="out.mcap", help="Session to write.")],
    rig: Annotated[Path | None, Option(help="Rig file (TOML): devices and calibration.")] = None,
    device: Annotated[list[str] | None, Option(help="Address, as `devices` lists it; repeatable.")] = None,
    seconds: Annotated[float | None, Option(min=0.1, help="Duration. Default: until Ctrl-C.")] = None,
    infrared: Annotated[
        bool, Option("--infrared", help="Record infrared images too, for calibrate.")
    ] = False,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Record depth, colour and temperature from devices, real or virtual, into a session."""
    with ExitStack() as stack:
        wanted, devices, calibration, _ = _opened(rig, device, stack)
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
        Path | None, Option(help="Session to write. Default: in place; NAME.mcap for NAME.mcap.partial.")
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Repair a recording that was cut off or damaged; every frame that can be read is kept."""
    done = repair_session(session, out, overwrite=overwrite)
    result = {
        "session": str(done.path),
        "frames": done.frames,
        "lost_seconds": round(done.lost_s, 3),
        "damaged": done.damaged,
        "changed": done.changed,
    }
    text = f"{done.path} is whole, with {done.frames} frames"
    if not done.changed:
        text += "; nothing to repair"
    if done.lost_s:
        text += f"; {cell(done.lost_s, 's')} could not be saved"
    if done.damaged:
        text += f"; {done.damaged} damaged records left out"
    finish(result, json, text)


def open_rig(rig: Path | None, device: list[str] | None) -> LiveRig:
    """The rig that a file or addresses name, its devices started. Raises DeviceError, CalibrationError."""
    with ExitStack() as stack:
        wanted, devices, calibration, open_one = _opened(rig, device, stack)
        running = LiveRig(wanted.name, devices, calibration, wanted.latency_ms, open_one)
        stack.pop_all()
    return running


def _opened(
    rig: Path | None, device: list[str] | None, stack: ExitStack
) -> tuple[RecordingRig, list[Device], RigCalibration, Callable[[str], Device]]:
    """A rig, its devices opened and started within a stack, its calibration, what opens a device again."""
    if (rig is None) == (not device):
        raise DeviceError("no device to record from; give either --rig or one or more --device")
    wanted = load_rig(rig) if rig is not None else RecordingRig("rig", tuple(device or ()))
    shown = Shown() if any(address.startswith("virtual:") for address in wanted.devices) else None

    def started(address: str) -> Device:
        opened = open_device(address, shown or ())
        try:
            opened.start()
        except DeviceError:
            opened.close()
            raise
        return opened

    devices = [stack.enter_context(closing(started(address))) for address in wanted.devices]
    return wanted, devices, _calibration(wanted, devices, shown), started


def _calibration(rig: RecordingRig, devices: list[Device], shown: Shown | None) -> RigCalibration:
    """The rig file's; else the virtual rig's; else the factory's, of a depth camera that has started."""
    if rig.calibration is not None:
        return rig.calibration
    if shown is not None:
        return shown.calibration
    factory = next((one.calibration for one in devices if one.calibration is not None), None)
    if factory is None:
        raise CalibrationError("no device reports depth intrinsics; name a calibration in a --rig file")
    say("no calibration but the depth camera's own; run `calibrate` for the other cameras")
    return factory


@contextmanager
def _preview() -> Iterator[Callable[[Recorder], None]]:
    """Show the state of the recording once a second; Ctrl-C ends it."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines()
        return
    with Live(console=console, transient=True, auto_refresh=False) as live:
        yield lambda recorder: live.update(_table(recorder), refresh=True)


def _table(recorder: Recorder) -> Table:
    table = Table("stream", "images", "a second", "dropped", "now", title="recording; Ctrl-C ends it")
    for name, stream in recorder.streams.items():
        table.add_row(name, str(stream.count), f"{stream.rate_hz:.1f}", str(stream.dropped), stream.shows)
    return table


def _lines() -> Callable[[Recorder], None]:
    printed = time.monotonic()

    def show(recorder: Recorder) -> None:
        nonlocal printed
        if time.monotonic() - printed >= LINE_SECONDS:
            printed = time.monotonic()
            parts = (
                f"{name} {stream.rate_hz:.1f}/s, {stream.dropped} dropped, {stream.shows}"
                for name, stream in recorder.streams.items()
            )
            say("; ".join(parts))

    return show


def _report(out: Path, done: Recorded, json: bool) -> None:
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
    """List devices that are plugged in, virtual ones, and what each kind needs and was tested with."""
    found = find_devices()
    title = "no device is plugged in; virtual devices:" if all(one.virtual for one in found) else ""
    rows = [(one.address, one.serial, one.note) for one in found]
    kinds = [(kind, known.needs.replace("`", ""), known.tested) for kind, known in KINDS.items()]
    title_of_kinds = "what can be connected; no driver has ever met its hardware, but:"
    text = table(("address", "serial", "note"), rows, title)
    text += "\n" + table(("kind", "needs", "tested with"), kinds, title_of_kinds)
    answer = {"devices": [asdict(one) for one in found], "kinds": {k: v._asdict() for k, v in KINDS.items()}}
    finish(answer, json, text)
