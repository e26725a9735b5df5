"""Names of a recording while it is being written, and once it is complete."""

from pathlib import Path

SUFFIX, PARTIAL = ".mcap", ".partial"


def partial_of(path: Path) -> Path:
    """Name of the session ``path`` until it is complete."""
    return path.with_name(path.name + PARTIAL)


def final_of(path: Path) -> Path:
    """The session's name once it is complete."""
    return path.with_name(path.name.removesuffix(PARTIAL))


def recording_at(path: Path) -> Path:
    """The path, or its unfinished recording where that alone is there: people name what they recorded to."""
    return partial_of(path) if not path.exists() and partial_of(path).is_file() else path


def repaired_of(path: Path) -> Path:
    """Name of the repaired copy of the session ``path``."""
    return path.with_name(f"{path.name.removesuffix('.mcap')}.repaired.mcap")
