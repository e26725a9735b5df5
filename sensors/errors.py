"""The one tree of errors that a user can cause or meet."""


class CloudError(Exception):
    """Root of all expected errors.

    The message is one line: what is wrong, the value, and the remedy. Only ``cli`` prints it.
    """


class FormatError(CloudError):
    """Data from outside is not what it claims to be: corrupt, truncated, or of impossible size."""


class CalibrationError(CloudError):
    """Calibration is missing, or contradicts the images it comes with."""


class ExistsError(CloudError):
    """A result already exists and nobody asked for it to be replaced."""
