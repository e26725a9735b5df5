"""The folder of a learning: how it is known again."""

from pathlib import Path

from sensors.errors import ExistsError
from sensors.files.atomic import is_taken

RECORD, RUN = "learnt.json", "run"
"""What was learnt, and the folder of a run that has not ended."""


def check_own(out: Path) -> None:
    """Raise ExistsError for a folder that holds something else than a learning."""
    if is_taken(out) and not ((out / RECORD).is_file() or (out / RUN).is_dir()):
        raise ExistsError(f"{out} was not made by this command (it has no {RECORD}); choose another folder")
