"""The verb ``try``: import an RGB-D recording, label it by colour and by depth alone, and compare both."""

import json as jsons
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from cli.agreement import agreement_text, compared, write_page
from cli.console import Json, finish, progress, say
from cli.extras import check_extra
from cli.sessions import open_recording, recordings_in
from cli.verbs.exchange import write_session
from cli.verbs.labels.labelling import COLOUR, LabelChoices
from cli.verbs.labels.prediction import PredictChoices
from sensors.errors import CloudError, ExistsError
from sensors.files.atomic import is_taken, write_bytes
from sensors.importers.open_source import doubts_of

if TYPE_CHECKING:
    from annotate.label_recording import Run
    from annotate.labelset.labelled_frames import LabelledFrames
    from eval.compare.agreement import Agreement
    from sensors.importers.open_source import Source

MARKER = "try.json"
RECORDING, BY_COLOUR, BY_DEPTH, REPORT = "recording.mcap", "by-colour", "by-depth", "report.html"


def try_(
    recording: Annotated[
        Path, Argument(help="Recording with depth and colour, of any kind that import reads.")
    ],
    out: Annotated[Path, Option(help="Folder for all results; an interrupted run continues there.")],
    json: Json = False,
) -> None:
    """Label your own RGB-D recording by colour and by depth alone, and report where both differ.

    Writes the imported recording, both label sets and report.html; prints what was assumed, and the command
    that opens both label sets in the window.
    """
    check_extra("report", "jinja2", "plotly")
    from annotate.witness.coloured_cloud import ColourFuser

    if several := recordings_in(recording):
        raise CloudError(f"{recording} has {len(several)} sessions; give one, for example {several[0]}")
    source = open_recording(recording, names=False)
    ColourFuser(source.calibration)
    by_colour = LabelChoices(by=COLOUR).work()
    _begin(out, recording)
    source = _as_session(source, recording, out)
    with progress("label by colour", len(source)) as advance:
        runs = {BY_COLOUR: by_colour(source, out / BY_COLOUR, advance)}
    by_depth = PredictChoices(None, None, False, False, None, None).work(source, out / BY_DEPTH)
    with progress("label by depth", len(source)) as advance:
        runs[BY_DEPTH] = by_depth(advance)
    remarks, failed = _remarks(runs), [one for run in runs.values() for one in run.failed]
    say(*remarks)
    session = out / RECORDING if (out / RECORDING).is_file() else recording
    found = _reported(runs, session, out, remarks)
    commands = next_commands(out, session)
    pairs = [one.to_json() for one in found]
    result = {"frames": len(source), "failed": len(failed), "remarks": remarks, "pairs": pairs}
    lines = (f"{title}:\n  {command}" for title, command in commands.items())
    text = "\n".join([agreement_text(found), "", f"report: {out / REPORT}", *lines])
    finish({**result, "report": str(out / REPORT), "commands": commands}, json, text)
    if failed:
        raise typer.Exit(3)


def _begin(out: Path, recording: Path) -> None:
    """Start the folder, or check that an earlier run of this recording did."""
    marker, origin = out / MARKER, {"recording": str(recording.resolve())}
    if not marker.is_file():
        if is_taken(out):
            raise ExistsError(f"{out} already exists; choose another folder")
        out.mkdir(parents=True, exist_ok=True)
        write_bytes(marker, jsons.dumps(origin).encode())
    elif jsons.loads(marker.read_bytes()) != origin:
        raise ExistsError(f"{out} is of another recording; choose another folder")


def _as_session(source: "Source", recording: Path, out: Path) -> "Source":
    """Return the recording as a session: itself, or imported into the folder."""
    from sensors.session.reader import Session

    if isinstance(source, Session):
        say(*source.notes, *doubts_of(source))
        return source
    if not (out / RECORDING).is_file():
        write_session(source, out / RECORDING, overwrite=True)  # of the partial file of a killed run
    return open_recording(out / RECORDING, names=False)


def _remarks(runs: "dict[str, Run]") -> list[str]:
    """Return each warning of each run with the number of its frames, and each failed frame."""
    remarks = [
        f"{name}: {len(frames)} of {len(run.labels)} frames, first {frames[0]}: {remark}"
        for name, run in runs.items()
        for remark, frames in run.remarks().items()
    ]
    return remarks + [f"{name}: frame {at}: {why}" for name, run in runs.items() for at, why in run.failed]


def _reported(runs: "dict[str, Run]", session: Path, out: Path, remarks: list[str]) -> "list[Agreement]":
    """Compare both label sets, and write the report unless an earlier run did."""
    sets: dict[str, LabelledFrames] = {name: runs[name].labels for name in (BY_DEPTH, BY_COLOUR)}
    found = compared(sets)
    if (out / REPORT).exists():
        say(f"{out / REPORT} is of an earlier run and stays; remove it to get a new one")
    else:
        write_page(sets, found, session, out / REPORT, *remarks)
    return found


def next_commands(out: Path, session: Path) -> dict[str, str]:
    """Return the commands that follow, by their purpose. session: the labelled recording."""
    window = ["fix", str(out / BY_COLOUR), "--compare", str(out / BY_DEPTH), "--session", str(session)]
    return {"both in the window": shlex.join(["annotate-cloud", *window])}
