"""Where a simulated session's truth and suit lie; known without the rig."""

from pathlib import Path


def truth_path(session: Path) -> Path:
    """Where the truth of a simulated session lies: ``people.truth/`` beside ``people.mcap``."""
    return session.with_suffix(".truth")


def suit_path(session: Path) -> Path:
    """Where the palette of a simulated session's suit lies."""
    return session.with_suffix(".suit.toml")
