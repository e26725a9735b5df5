"""Whether a file is a result, without the second that importing what reads it takes."""

from pathlib import Path

from sensors.errors import FormatError
from sensors.files.npz import array_sizes

REMEDY = "give a result of 'evaluate --out'; evaluate again where another version wrote it"


def check_results(*paths: Path) -> None:
    """Check that files have the arrays of a result. Raises FormatError for the first that has not."""
    for path in paths:
        if missing := {"counts", "texts"} - set(array_sizes(path, REMEDY)):
            raise FormatError(f"{path} is not a result ({sorted(missing)[0]!r}); {REMEDY}")
