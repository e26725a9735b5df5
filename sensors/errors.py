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
