"""The verb fix: the correction window."""

from pathlib import Path
from typing import Annotated

import typer

from cli.extras import needing


def fix(
    labels: Annotated[Path, typer.Argument(metavar="LABELS", help="Label set to correct, of any origin.")],
    session: Annotated[
        Path | None,
        typer.Option(help="Its recording, for colour and temperature; found if it lies beside."),
    ] = None,
    compare: Annotated[Path | None, typer.Option(help="Another label set, to see where they differ.")] = None,
    who: Annotated[str, typer.Option(help="Who corrects; the system's user by default.")] = "",
    read_only: Annotated[bool, typer.Option("--read-only", help="Look, and change nothing.")] = False,
) -> None:
    """Correct part labels in a window: F1 shows its keys. Every stroke is saved as it is made."""
    with needing("gui"):
        from annotate.gui.app import run_window
    states = run_window(labels, session, compare, who, read_only)
    print(f"{labels}: " + ", ".join(f"{count} {state}" for state, count in states.items()))
