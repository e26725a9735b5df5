"""Devices of a rig file or of addresses, opened and started; scenes of virtual cameras."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from cli.console import say
from cli.extras import needing
from sensors.device.address import Address
from sensors.device.protocol import Device
from sensors.errors import CalibrationError, DeviceError
from sensors.recording.live_rig import LiveRig
from sensors.recording.open_device import check_kind, open_device
from sensors.recording.rig_file import RecordingRig, load_rig
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration

if TYPE_CHECKING:
    from sensors.calibrate.hole_plate import HolePlate
    from sensors.session.reader import Session
    from synth.rig.plate_views import PlateViews
    from synth.rig.virtual_rig import VirtualRig

VIRTUAL_SEED = 7
VIRTUAL_FRAMES = 30  # at 30 a second, which the virtual cameras repeat
VIRTUAL_VIEWS, HELD_S = 24, 4.0  # views of the plate, of which a calibration takes 12 to 14; untuned


class Shown:
    """Frames of the virtual cameras, rendered on first use. plate: hole plate in view, None = a person."""

    def __init__(self, plate: "HolePlate | None" = None) -> None:
        self._plate = plate

    @cached_property
    def _rig(self) -> "VirtualRig | PlateViews":
        with needing("synth"):
            from synth.rig.plate_views import PlateViews
            from synth.rig.virtual_rig import RigOptions, VirtualRig
        if self._plate is not None:
            from sensors.recording.rig_templates import REFERENCE, TEMPLATES

            template = replace(TEMPLATES[REFERENCE], plate=self._plate)
            return PlateViews(template, VIRTUAL_VIEWS, VIRTUAL_SEED, bad_share=0.0)
        return VirtualRig(
            VIRTUAL_FRAMES, 1, "normal", VIRTUAL_SEED, RigOptions(frames_per_second=VIRTUAL_FRAMES)
        )

    @property
    def calibration(self) -> RigCalibration:
        """Return the calibration of the virtual rig; approximate if the plate is in view."""
        if self._plate is None:
            return self._rig.calibration
        from synth.rig.plate_views import roughly

        return roughly(self._rig.calibration)

    def __iter__(self) -> Iterator[RigFrame]:
        return iter(self._frames)

    @cached_property
    def _frames(self) -> tuple[RigFrame, ...]:
        say(f"rendering {len(self._rig)} frames for the virtual cameras")
        if self._plate is None:
            return tuple(self._rig)
        return tuple(replace(frame, stamp_ns=round(1e9 * HELD_S * frame.index)) for frame in self._rig)


def open_rig(rig: Path | None, device: list[str] | None, plate: "HolePlate | None" = None) -> LiveRig:
    """Open a rig and start its devices. plate: hole plate in view of virtual cameras, None = a person.

    Raises DeviceError, CalibrationError.
    """
    with ExitStack() as stack:
        wanted, devices, calibration, open_one = opened_rig(rig, device, stack, plate)
        running = LiveRig(wanted.name, devices, calibration, wanted.latency_ms, open_one)
        stack.pop_all()
    return running


def check_one_source(**given: object) -> None:
    """Raise DeviceError unless exactly one source is given. given: by argument name."""
    names = ["--" + name if name != "session" else "a session" for name in given]
    chosen = [name for name, value in zip(names, given.values(), strict=True) if value]
    choice = f"{', '.join(names[:-1])} or one or more {names[-1]}"
    if not chosen:
        raise DeviceError(f"no source is given; give either {choice}")
    if len(chosen) > 1:
        raise DeviceError(f"{' and '.join(chosen)} are given; give only one of {choice}")


def rig_of(rig: Path | None, device: list[str] | None) -> RecordingRig:
    """Return the rig of a file or of addresses without opening it. Raises DeviceError and CalibrationError as
    ``load_rig``.
    """
    check_one_source(rig=rig, device=device)
    wanted = load_rig(rig) if rig is not None else RecordingRig("rig", tuple(device or ()))
    for address in wanted.devices:
        check_kind(Address(address))
    return wanted


def opened_rig(
    rig: Path | None, device: list[str] | None, stack: ExitStack, plate: "HolePlate | None" = None
) -> tuple[RecordingRig, list[Device], RigCalibration, Callable[[str], Device]]:
    """Return a rig, its started devices, its calibration, and a function that reopens a device.

    stack: closes the devices. The returned rig uses the devices' own addresses.
    """
    wanted = rig_of(rig, device)
    shown = Shown(plate) if any(address.startswith("virtual:") for address in wanted.devices) else None
    given_address = dict[str, str]()

    def started(address: str) -> Device:
        # A device's own address may lack the options of the given address.
        given = given_address.get(address, address)
        opened = open_device(given, shown or ())
        try:
            opened.start()
        except BaseException:
            opened.close()
            raise
        given_address[opened.address] = given
        return opened

    devices = [stack.enter_context(closing(started(address))) for address in wanted.devices]
    own = {given: device.address for given, device in zip(wanted.devices, devices, strict=True)}
    latency_ms = {own[address]: ms for address, ms in wanted.latency_ms.items()}
    wanted = replace(wanted, devices=tuple(own.values()), latency_ms=latency_ms)
    return wanted, devices, _calibration(wanted, devices, shown), started


def _calibration(rig: RecordingRig, devices: list[Device], shown: Shown | None) -> RigCalibration:
    """Return the calibration of the rig file, else of the virtual rig, else of the depth camera's factory."""
    if rig.calibration is not None:
        return rig.calibration
    if shown is not None:
        return shown.calibration
    factory = next((one.calibration for one in devices if one.calibration is not None), None)
    if factory is None:
        raise CalibrationError("no device reports depth intrinsics; name a calibration in a --rig file")
    say("only the depth camera's own calibration is known; run `calibrate` for the other cameras")
    return factory


def check_infrared(session: "Session") -> None:
    """Raise CalibrationError for a session without infrared images."""
    if "/infrared/image" not in session.streams:
        raise CalibrationError(
            f"{session.path} has no infrared images; record with --infrared, or give --check"
        )
