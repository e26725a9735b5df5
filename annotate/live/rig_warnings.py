"""Complaints about a rig: devices, drops, clocks, the flag, the disk."""

from collections.abc import Iterator

from annotate.live.warning import Kind, LiveWarning
from sensors.recording.image_check import NAMES
from sensors.recording.stream_health import Health, StreamHealth
from sensors.rig.clock import LIMIT_SKEW

DROPPED_SHARE = 0.01
"""Share of a stream's images lost in five seconds that gives a warning: one depth image of 150 may go while
the system is busy. Untuned."""
SILENT_S, SILENT_PERIODS = 1.0, 5
"""Seconds and periods of a stream without any image from which it is silent. Untuned."""
SLOW_SHARE, SETTLING_S = 0.75, 5.0
"""Share of its nominal rate below which a stream is slow (in the dark a colour camera exposes for two
periods); seconds after the start before rates are judged. Untuned."""
FLAG_S = 2.0
"""Seconds for which a flag may be closed: a PI200's is for half a second, a Lepton's for one and a half."""
LEAST_DISK_MINUTES = 10.0
"""Minutes of recording that should fit on the disk. Untuned."""
TOO_SLOW = ("this computer is too slow: close other programs",
            "the disk is too slow: record to a faster one, or close other programs")  # fmt: skip
"""Remedies for images lost in a full queue: without a recording, and during one."""
REMEDIES = {"color": "light the room: in the dark a camera exposes for longer", "": "close other programs"}
"""Remedies for a slow stream, by its name; "" for all others."""


def rig_warnings(health: Health) -> Iterator[LiveWarning]:
    """Yield all warnings about a rig at one moment."""
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
            "there are no temperatures; unplug the camera and plug it in again",
        )
    clocks = [
        f"the clock of {address} {'gains' if ppm > 0 else 'loses'} {abs(ppm) * 0.06:.0f} ms a minute: "
        "its images will not match the others; record in short pieces, or replace the device"
        for address, ppm in health.skew_ppm.items()
        if abs(ppm) > LIMIT_SKEW * 1e6
    ]
    # A busy computer reads images later and later, which looks like a slow clock.
    if clocks and not any(_is_losing(state) for state in health.streams.values()):
        yield LiveWarning("clock", "; ".join(clocks))
    if health.disk_minutes < LEAST_DISK_MINUTES:
        yield LiveWarning(
            "disk", f"the disk has room for {health.disk_minutes:.1f} minutes of recording: free some space"
        )


def _is_losing(state: StreamHealth) -> bool:
    """Return whether a stream has lost a larger share of its recent images than ``DROPPED_SHARE``."""
    return state.lost > DROPPED_SHARE * (state.recent + state.lost) and state.lost > 1


def _is_silent(state: StreamHealth) -> bool:
    period_s = 1 / state.nominal_hz if state.nominal_hz else 0.0
    return state.silent_s > max(SILENT_S, SILENT_PERIODS * period_s)


def _of_streams(health: Health) -> Iterator[LiveWarning]:
    """Yield warnings about streams of present devices, one for each kind, with all streams of each remedy."""
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
    """Return kind, fault and remedy of a stream; None for a good one."""
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
        return "drops", slow, REMEDIES.get(stream, REMEDIES[""])
    return None
