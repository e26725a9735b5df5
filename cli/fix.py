"""The verb fix: the correction window."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from cli.extras import needing


def fix(
    labels: Annotated[Path, Argument(help="Label set to correct.")],
    session: Annotated[
        Path | None,
        Option(help="Recording of these labels, for colour and temperature. Default: the one beside them."),
    ] = None,
    compare: Annotated[Path | None, Option(help="Another label set, to show the differences.")] = None,
    who: Annotated[str, Option(help="Name of the person who corrects. Default: the system user.")] = "",
    read_only: Annotated[bool, Option("--read-only", help="Open without changing anything.")] = False,
) -> None:
    """Correct part labels in a window; F1 shows the keys. Every stroke is saved at once."""
    with needing("gui"):
        from annotate.gui.app import run_window
    states = run_window(labels, session, compare, who, read_only)
    print(f"{labels}: " + ", ".join(f"{count} {state}" for state, count in states.items()))
