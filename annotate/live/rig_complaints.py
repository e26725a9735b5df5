"""Complaints about a rig: devices, drops, clocks, the flag, the disk."""

from collections.abc import Iterator

from annotate.live.complaint import Complaint
from sensors.recording.health import Health, StreamHealth
from sensors.rig.clock import LIMIT_SKEW

DROPPED_SHARE = 0.01
"""Share of a stream's images lost in five seconds from which it is said. Chosen by eye: one depth image of
150 may go while the system is busy with something else."""
SILENT_S, SILENT_PERIODS = 1.0, 5
"""Seconds and periods of a stream without any image from which it is silent. Chosen by eye."""
SLOW_SHARE, SETTLING_S = 0.75, 5.0
"""Share of its nominal rate below which a stream is slow, as is a colour camera that exposes for two periods
in the dark; seconds after the start before rates are judged. Chosen by eye."""
FLAG_S = 2.0
"""Seconds for which a flag may be closed: a PI200's is for half a second, a Lepton's for one and a half."""
LEAST_DISK_MINUTES = 10.0
"""Minutes of recording that should fit on the disk. Chosen by eye."""
NAMES = {"depth": "depth", "color": "colour", "thermal": "thermal", "pyrometer": "pyrometer"}
TOO_SLOW = ("this computer is too slow: close other programs",
            "the disk is too slow: record to a faster one, or close other programs")  # fmt: skip
"""What to do about images that nobody took in time: while nothing is recorded, and while something is."""
REMEDIES = {"color": "light the room: in the dark a camera exposes for longer", "": "close other programs"}


def rig_complaints(health: Health) -> Iterator[Complaint]:
    """All complaints about a rig at one moment."""
    if health.trouble:
        yield Complaint("trouble", health.trouble)
    if health.faults:
        yield Complaint("fault", "; ".join(health.faults))
    for address in health.away:
        yield Complaint("away", f"{address} is gone: plug it in again; it is opened as soon as it is back")
    if not health.away:
        for stream, state in health.streams.items():
            yield from _of_stream(stream, state, health)
    if health.flag_closed_s > FLAG_S:
        yield Complaint(
            "flag",
            f"the thermal camera's flag has been closed for {health.flag_closed_s:.0f} s: "
            "there are no temperatures; unplug the camera and plug it in again",
        )
    for address, ppm in health.skew_ppm.items():
        if abs(ppm) > LIMIT_SKEW * 1e6:
            way = "gains" if ppm > 0 else "loses"
            yield Complaint(
                "clock",
                f"the clock of {address} {way} {abs(ppm) * 0.06:.0f} ms a minute: "
                "its images will not match the others; record in short pieces, or replace the device",
            )
    if health.disk_minutes < LEAST_DISK_MINUTES:
        yield Complaint(
            "disk", f"the disk has room for {health.disk_minutes:.1f} minutes of recording: free some space"
        )


def _of_stream(stream: str, state: StreamHealth, health: Health) -> Iterator[Complaint]:
    name, nominal_hz = NAMES.get(stream, stream), state.nominal_hz
    if state.silent_s > max(SILENT_S, SILENT_PERIODS / nominal_hz if nominal_hz else 0.0):
        if health.flag_closed_s == 0 or stream != "thermal":
            since = "no image" if state.count == 0 else f"no image for {state.silent_s:.0f} s"
            yield Complaint("silent", f"{name}: {since}; check the cable, then plug the device in again")
        return
    if state.lost > DROPPED_SHARE * (state.recent + state.lost) and state.lost > 1:
        remedy = "close other programs, and give the camera a USB port of its own"
        if state.overrun > state.lost / 2:
            remedy = TOO_SLOW[health.recording is not None]
        share = f"{state.lost} of {state.recent + state.lost} images"
        yield Complaint("drops", f"{name}: {share} lost in the last five seconds; {remedy}")
    elif 0 < state.rate_hz < SLOW_SHARE * nominal_hz and health.running_s > SETTLING_S:
        remedy = REMEDIES.get(stream, REMEDIES[""])
        yield Complaint("drops", f"{name}: {state.rate_hz:.0f} of {nominal_hz:.0f} images a second; {remedy}")
