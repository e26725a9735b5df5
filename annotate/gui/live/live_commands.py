"""Commands of the live window: their keys, and what each of them does."""

from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path

from annotate.gui.state.keys import Command

COMMANDS = (
    Command("record", "Space", "Recording", "Record", "Start or stop recording"),
    Command("mark", "M", "Recording", "Mark an event…", "Mark what happens now with a short text"),
    Command("name", "N", "Recording", "Name of the person…", "Written into the next recording"),
    Command("ahead", "A", "View", "From the camera", "Show the person as the depth camera sees them"),
    Command("colouring", "C", "View", "Next colouring", "Temperature, colour, parts or depth of the cloud"),
    Command("toggle_theme", "T", "View", "Light or dark"),
    Command("close", "Ctrl+Q", "View", "Close", "End the recording, and close"),
    Command("help", "F1", "View", "All keys", "Show this list"),
)
"""All of them, by their menus."""


def takes(first: Path | None, now: Callable[[], datetime] = datetime.now) -> Iterator[Path]:
    """Yield sessions to record to, none of which exists: ``first``, then with -2, -3, ...

    first: None names each by the time at which it begins. now: clock for that.
    """
    number = 1
    while True:
        stem = first or Path(f"take-{now():%Y%m%d-%H%M%S}.mcap")
        path = stem if number == 1 else stem.with_name(f"{stem.stem}-{number}{stem.suffix}")
        if not path.exists() or (first is not None and number == 1):
            yield path
            number = number + 1 if first else 1
        else:
            number += 1
