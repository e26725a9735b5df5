"""Hierarchy of expected errors, caused by users, data or devices, and settings that mend them."""

import re
from enum import Enum
from typing import Self

_LACKING = re.compile(r"missing \d+ required .*arguments?: (.+)")
_UNKNOWN = re.compile(r"unexpected keyword argument ('.*')")
_KINDS: tuple[tuple[type[Exception] | tuple[type[Exception], ...], str], ...] = (
    (IndexError, "it holds too few values"),
    ((TypeError, AttributeError), "a value has the wrong type"),
    (OverflowError, "a number is too large"),
    (RecursionError, "it is nested too deeply"),
)

LONGEST = 1000  # characters of a message, because a file may be quoted at any length


def one_line(text: str) -> str:
    """Return text for a terminal: line ends as spaces, other control characters escaped."""
    return "".join(
        c if c.isprintable() else " " if c.isspace() else c.encode("unicode_escape").decode() for c in text
    )


def fault_of(error: Exception) -> str:
    """Return the fault of parsed data as text: fields by name, no names of Python's own.

    error: exception of code that reads fields of a file. A ValueError or CloudError keeps its text.
    """
    text = str(error)
    if isinstance(error, KeyError):
        return f"field {text} is missing"
    if lacking := _LACKING.search(text):
        return f"missing fields: {lacking[1]}"
    if unknown := _UNKNOWN.search(text):
        return f"field {unknown[1]} is unknown"
    return next((fault for kind, fault in _KINDS if isinstance(error, kind)), text)


class Setting(Enum):
    """Setting of a caller. A verb of the command has an option of that name, or lacks it."""

    OVERWRITE = "overwrite"
    INTRINSICS = "intrinsics"
    DEPTH_UNIT = "depth-unit"
    TURN = "turn"
    MIRROR = "mirror"
    AXES = "axes"
    TOPIC = "topic"
    RATE = "rate"
    SESSION = "session"
    WEIGHTS = "weights"
    SCHEME = "scheme"
    MAP = "map"
    FRAME = "frame"
    FACES = "faces"
    COLOUR = "colour"
    PORT = "port"
    UP = "up"
    MARKERSET = "markerset"
    TAKE = "take"
    SCHEDULER = "scheduler"
    WORKERS = "workers"
    PRECISION = "precision"
    SEED = "seed"
    INIT = "init"
    NETWORK = "network"


class Note(str):
    """Remark on data. settings: settings that change the data."""

    settings: tuple[Setting, ...]

    def __new__(cls, text: str, *settings: Setting) -> Self:
        note = super().__new__(cls, text)
        note.settings = settings
        return note


class CloudError(Exception):
    """Root of all expected errors. The message is one line: the fault, the value, the remedy.

    settings: settings that mend the fault; a verb names its options for them.
    """

    def __init__(self, text: str = "", *settings: Setting) -> None:
        super().__init__(text)
        self.settings = settings

    def __str__(self) -> str:
        text, half = super().__str__(), LONGEST // 2
        return one_line(text if len(text) <= LONGEST else f"{text[:half]} ... {text[-half:]}")


class FormatError(CloudError):
    """Error of outside data that are corrupt, truncated, of impossible size or of another format."""


class CalibrationError(CloudError):
    """Error of a calibration that is missing or contradicts its images."""


class ExistsError(CloudError):
    """Error of a result that exists already."""


class DeviceError(CloudError):
    """Error of a device."""


class DeviceNotFoundError(DeviceError):
    """Error of a missing device, or of a missing library that drives it."""


class DeviceAccessError(DeviceError):
    """Error of a device that the system's permissions refuse to this user."""


class DeviceBusyError(DeviceError):
    """Error of a device that is open elsewhere."""


class DeviceLostError(DeviceError):
    """Error of a device that was unplugged, or stopped answering for good."""


class DeviceFaultError(DeviceError):
    """Error of a device that breaks its protocol; the next reading may be sound."""
