"""Hierarchy of expected errors, caused by users, data or devices."""

LONGEST = 1000  # characters of a message, because a file may be quoted at any length


def one_line(text: str) -> str:
    """Return text for a terminal: line ends as spaces, other control characters escaped."""
    return "".join(
        c if c.isprintable() else " " if c.isspace() else c.encode("unicode_escape").decode() for c in text
    )


class CloudError(Exception):
    """Root of all expected errors. The message is one line: the fault, the value, the remedy."""

    def __str__(self) -> str:
        text, half = super().__str__(), LONGEST // 2
        return one_line(text if len(text) <= LONGEST else f"{text[:half]} ... {text[-half:]}")


class FormatError(CloudError):
    """Data from outside is corrupt, truncated, of impossible size or of another format."""


class CalibrationError(CloudError):
    """Calibration is missing or contradicts its images."""


class ExistsError(CloudError):
    """A result exists already."""


class DeviceError(CloudError):
    """A device fails."""


class DeviceNotFoundError(DeviceError):
    """The device or the library that drives it is missing."""


class DeviceAccessError(DeviceError):
    """The system's permissions refuse the device to this user."""


class DeviceBusyError(DeviceError):
    """The device is open elsewhere."""


class DeviceLostError(DeviceError):
    """The device was unplugged, or stopped answering for good."""


class DeviceFaultError(DeviceError):
    """The device breaks its protocol; the next reading may be sound."""
