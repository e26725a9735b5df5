"""Rig file: devices of a rig and its calibration, a path to the output of `calibrate` or to OpenCV YAML::

name = "ward 3"
calibration = "ward3.json"

devices = ["kinect2:", "optris:/dev/video0?mode=128hz", "pyrometer:/dev/ttyUSB0?family=ct"]

[latency_ms]  # from exposure to arrival, if known
"kinect2:" = 25
"""

from dataclasses import dataclass, field
from pathlib import Path

from sensors.calibration_files.calibration_yaml import open_calibration
from sensors.device.address import Address
from sensors.errors import DeviceError
from sensors.files.bounded import read_toml
from sensors.rig.pairing import MAX_LATENCY_MS
from sensors.rig.rig_calibration import RigCalibration

MAX_BYTES = 100_000  # of a rig file; ten devices take 1,000
KEYS = ("name", "calibration", "devices", "latency_ms")


@dataclass(frozen=True)
class RecordingRig:
    """Rig of devices by address; latency_ms: by address. Raises DeviceError for no devices, repeated ones, or
    impossible latencies.
    """

    name: str
    devices: tuple[str, ...]
    calibration: RigCalibration | None = None
    latency_ms: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.devices:
            raise DeviceError(f"rig {self.name!r} names no devices; give at least one")
        for address in self.devices:
            Address(address)
            if self.devices.count(address) > 1:
                raise DeviceError(f"rig {self.name!r} names {address!r} twice; name each device once")
        for address, latency_ms in self.latency_ms.items():
            if address not in self.devices:
                raise DeviceError(
                    f"rig {self.name!r}: latency_ms names {address!r}, not one of its devices; use "
                    f"{', '.join(self.devices)}"
                )
            if not 0 <= latency_ms <= MAX_LATENCY_MS:
                raise DeviceError(f"latency_ms of {address!r} is {latency_ms}; give 0 to {MAX_LATENCY_MS:g}")


def load_rig(path: Path) -> RecordingRig:
    """Read a rig file; the calibration's path is relative to it. Raises DeviceError for a malformed file,
    CalibrationError for its calibration.
    """
    fields = read_toml(path, MAX_BYTES, "give a rig file (TOML)", DeviceError)
    if unknown := sorted(set(fields) - set(KEYS)):
        raise DeviceError(f"rig file {path} has unknown key {unknown[0]!r}; use {', '.join(KEYS)}")
    devices, latency = fields.get("devices", []), fields.get("latency_ms", {})
    if not isinstance(devices, list) or not all(isinstance(address, str) for address in devices):
        raise DeviceError(f"rig file {path}: devices is {devices!r}; give a list of addresses")
    if not isinstance(latency, dict) or not all(isinstance(ms, int | float) for ms in latency.values()):
        raise DeviceError(f"rig file {path}: latency_ms is {latency!r}; give milliseconds by address")
    calibration = fields.get("calibration")
    if calibration is not None and not isinstance(calibration, str):
        raise DeviceError(f"rig file {path}: calibration is {calibration!r}; give a path")
    return RecordingRig(
        str(fields.get("name", path.stem)),
        tuple(devices),
        None if calibration is None else open_calibration(path.parent / calibration),
        latency,
    )
