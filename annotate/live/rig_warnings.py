"""Warnings about a rig: devices, drops, clocks, thermal flag (shutter), disk. Constants are untuned."""

from collections.abc import Iterator

from annotate.live.warning import Kind, LiveWarning
from sensors.recording.image_check import NAMES
from sensors.recording.stream_health import Health, StreamHealth
from sensors.rig.clock import LIMIT_SKEW

DROPPED_SHARE = 0.01  # tolerated share of images lost in 5 s: one depth image of 150
SILENT_S, SILENT_PERIODS = 1.0, 5  # s and periods without an image that make a stream silent
SLOW_SHARE, SETTLING_S = 0.75, 5.0  # least share of the nominal rate, and s after the start before the check
FLAG_S = 2.0  # s; longest closed flag: a PI200's takes 0.5 s, a Lepton's 1.5 s
LEAST_DISK_MINUTES = 10.0  # of recording
TOO_SLOW = ("this computer is too slow: close other programs",
            "the disk is too slow: record to a faster one, or close other programs")  # fmt: skip
SLOW_COLOR = "light the room: in the dark a camera exposes for longer"


def rig_warnings(health: Health) -> Iterator[LiveWarning]:
    """Yield all warnings about a rig."""
    if health.trouble:
        yield LiveWarning("trouble", health.trouble)
    if health.faults:
        yield LiveWarning("fault", "; ".join(health.faults))
    if health.away:
        gone = ", ".join(f"{address} is gone" for address in health.away)
        yield LiveWarning("away", f"{gone}: plug it in again; it is opened as soon as it is back")
    yield from _of_streams(health)
    if health.flag_closed_s > FLAG_S:
        yield LiveWarning(
            "flag",
            f"the thermal camera's flag has been closed for {health.flag_closed_s:.0f} s: "
            "temperatures are missing; unplug the camera and plug it in again",
        )
    clocks = [
        f"the clock of {address} {'gains' if ppm > 0 else 'loses'} {abs(ppm) * 0.06:.0f} ms a minute: "
        "its images will not match the others; record in short pieces, or replace the device"
        for address, ppm in health.skew_ppm.items()
        if abs(ppm) > LIMIT_SKEW * 1e6
    ]
    # The delays of a busy computer grow, which looks like a slow clock.
    if clocks and not any(_is_losing(state) for state in health.streams.values()):
        yield LiveWarning("clock", "; ".join(clocks))
    if health.disk_minutes < LEAST_DISK_MINUTES:
        yield LiveWarning(
            "disk", f"the disk has room for {health.disk_minutes:.1f} minutes of recording: free some space"
        )


def _is_losing(state: StreamHealth) -> bool:
    """Return whether a stream lost a larger share of its recent images than ``DROPPED_SHARE``."""
    return state.lost > DROPPED_SHARE * (state.recent + state.lost) and state.lost > 1


def _is_silent(state: StreamHealth) -> bool:
    period_s = 1 / state.nominal_hz if state.nominal_hz else 0.0
    return state.silent_s > max(SILENT_S, SILENT_PERIODS * period_s)


def _of_streams(health: Health) -> Iterator[LiveWarning]:
    """Yield warnings about streams of connected devices; streams with the same remedy share a warning."""
    found = dict[tuple[Kind, str], list[str]]()
    for stream, state in health.streams.items():
        if not state.away and (one := _of_stream(stream, state, health)) is not None:
            kind, what, remedy = one
            found.setdefault((kind, remedy), []).append(f"{NAMES.get(stream, stream)}: {what}")
    texts = dict[Kind, list[str]]()
    for (kind, remedy), what_is in found.items():
        texts.setdefault(kind, []).append(f"{', '.join(what_is)}; {remedy}")
    for kind, each in texts.items():
        yield LiveWarning(kind, "; ".join(each))


def _of_stream(stream: str, state: StreamHealth, health: Health) -> tuple[Kind, str, str] | None:
    """Return the warning's kind, the fault and the remedy of a stream; None without a fault."""
    nominal_hz = state.nominal_hz
    if _is_silent(state):
        if health.flag_closed_s and stream == "thermal":
            return None
        since = "no image" if state.count == 0 else f"no image for {state.silent_s:.0f} s"
        started = [other for other in health.streams.values() if other.count and not other.away]
        if state.count and len(started) > 1 and all(map(_is_silent, started)):
            return "silent", since, TOO_SLOW[health.recording is not None]
        return "silent", since, "check the cable, then plug the device in again"
    if _is_losing(state):
        remedy = "close other programs, and give the camera a USB port of its own"
        if state.overrun > state.lost / 2:
            remedy = TOO_SLOW[health.recording is not None]
        lost = f"{state.lost} of {state.recent + state.lost} images lost in the last five seconds"
        return "drops", lost, remedy
    if 0 < state.rate_hz < SLOW_SHARE * nominal_hz and state.running_s > SETTLING_S:
        slow = f"{state.rate_hz:.0f} of {nominal_hz:.0f} images a second"
        return "drops", slow, SLOW_COLOR if stream == "color" else "close other programs"
    return None
