"""Verb ``fix``: correct labels in a window, and the command that fine-tunes on the corrections."""

import sys
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from cli.console import finish
from cli.extras import check_extra, needing
from sensors.importers.open_source import opener_at


def fix(
    labels: Annotated[Path, Argument(help="Label set to correct.")],
    session: Annotated[
        Path | None,
        Option(help="Recording, for colour and temperature. Default: the last one given, or the one beside."),
    ] = None,
    compare: Annotated[Path | None, Option(help="Another label set, to show the differences.")] = None,
    who: Annotated[str, Option(help="Name of the person who corrects. Default: the system user.")] = "",
    read_only: Annotated[bool, Option("--read-only", help="Open without changing anything.")] = False,
) -> None:
    """Correct part labels in a window; F1 shows the keys. Every stroke is saved at once."""
    check_extra("gui", "PySide6", "pyvista", "pyvistaqt")
    from annotate.correction.correction import Correction
    from annotate.labelset.label_set import LabelSet

    for path in (labels, *([compare] if compare else ())):
        LabelSet.open(path)
    if session is not None:
        opener_at(session)
    with needing("gui"):
        from annotate.gui.app import recording_of, run_window
        from annotate.gui.learning import LearnCommand
    recording = recording_of(labels, session)
    model = labels.resolve().with_name(f"{labels.resolve().name}.learnt")
    command = learn_command(labels, recording, model)
    correction = Correction.open(labels, who, read_only=read_only)
    states = run_window(correction, recording, compare, LearnCommand(command, model / "labels"))
    finish({}, False, f"{labels}: " + ", ".join(f"{count} {state}" for state, count in states.items()))


def learn_command(labels: Path, session: Path | None, model: Path) -> tuple[str, ...]:
    """Return the command that fine-tunes on corrections in the background, into the folder ``model``."""
    # -P: no module of the folder in which the user stands.
    verb = (sys.executable, "-P", "-m", "cli.main", "learn", str(labels), "--out", str(model), "--json")
    return (*verb, *(("--session", str(session)) if session else ()))
