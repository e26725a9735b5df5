"""The one tree of errors that a user can cause or meet."""

LONGEST = 1000
"""Characters of a message: what it quotes may have millions."""


def one_line(text: str) -> str:
    """Text that may quote data from outside, for a terminal: line ends as spaces, what steers it escaped."""
    return "".join(
        c if c.isprintable() else " " if c.isspace() else c.encode("unicode_escape").decode() for c in text
    )


class CloudError(Exception):
    """Root of all expected errors.

    The message is one line: what is wrong, the value, and the remedy. Only ``cli`` prints it.
    """

    def __str__(self) -> str:
        text = super().__str__()
        # What is wrong stands at the beginning, the remedy at the end.
        return one_line(
            text if len(text) <= LONGEST else f"{text[: LONGEST // 2]} ... {text[-LONGEST // 2 :]}"
        )


class FormatError(CloudError):
    """Data from outside is not what it claims to be: corrupt, truncated, or of impossible size."""


class CalibrationError(CloudError):
    """Calibration is missing, or contradicts the images it comes with."""


class ExistsError(CloudError):
    """A result already exists and is not to be replaced."""


class DeviceError(CloudError):
    """A device cannot do what it should."""


class DeviceNotFoundError(DeviceError):
    """No such device, or the library that drives it is not installed."""


class DeviceAccessError(DeviceError):
    """The device is there, but the system's permissions keep this user from it."""


class DeviceBusyError(DeviceError):
    """Somebody else, or another part of this program, has the device open."""


class DeviceLostError(DeviceError):
    """The device was unplugged, or stopped answering for good."""


class DeviceFaultError(DeviceError):
    """The device answers, but not what its protocol allows; the next read may be well again."""
