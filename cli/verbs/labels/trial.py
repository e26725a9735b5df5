"""The verb ``try``: import an RGB-D recording, label it by colour and by depth alone, and compare both."""

import json as jsons
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from cli.agreement import agreement_text, compared, write_page
from cli.console import Json, finish, progress, say
from cli.extras import check_extra
from cli.sessions import open_recording, recordings_in
from cli.verbs.exchange import write_session
from cli.verbs.labels.labelling import COLOUR, LabelChoices, check_colour
from cli.verbs.labels.prediction import PredictChoices
from cli.verbs.learning import adapted, adapted_text
from sensors.errors import CloudError, ExistsError
from sensors.files.atomic import check_folder_name, is_taken, write_bytes
from sensors.importers.open_source import doubts_of

if TYPE_CHECKING:
    from annotate.label_recording import Run
    from annotate.labelset.labelled_frames import LabelledFrames
    from eval.report.agreement import Agreement
    from sensors.importers.open_source import Source

MARKER = "try.json"
RECORDING, BY_COLOUR, BY_DEPTH, REPORT = "recording.mcap", "by-colour", "by-depth", "report.html"
ADAPTED, ADAPT_MINUTES = "adapted", 10.0


def try_(
    recording: Annotated[
        Path, Argument(help="Recording with depth and colour, of any kind that import reads.")
    ],
    out: Annotated[Path, Option(help="Folder for all results; an interrupted run continues there.")],
    adapt: Annotated[
        bool, Option("--adapt", help="Then fine-tune the depth network on these labels, ten minutes.")
    ] = False,
    json: Json = False,
) -> None:
    """Label your own RGB-D recording by colour and by depth alone, and report where both differ.

    Writes the imported recording, both label sets and report.html. Prints what was assumed, how far the
    labels agree, and the commands to continue with.
    """
    check_extra("report", "jinja2", "plotly")
    if adapt:
        check_extra("train", "torch", "onnx", "safetensors")
    runs, session = _labelled(recording, out)
    remarks, failed = _remarks(runs), [one for run in runs.values() for one in run.failed]
    say(*remarks)
    found = _reported(runs, session, out, remarks)
    result: dict[str, Any] = {
        "frames": len(found[0].comparison.frame_ids),
        "remarks": remarks,
        "pairs": [one.to_json() for one in found],
        "report": str(out / REPORT),
    }
    texts = [agreement_text(found), "", f"report: {out / REPORT}"]
    if adapt:
        done = adapted([out / BY_COLOUR], out / ADAPTED, ADAPT_MINUTES)
        result["adapted"] = done.fields()
        texts.append(f"adapted: {adapted_text(done)}")
    result["commands"] = next_commands(out, session)
    for title, command in result["commands"].items():
        texts += [f"{title}:", f"  {command}"]
    finish(result, json, *texts)
    if failed:
        raise typer.Exit(3)


def _labelled(recording: Path, out: Path) -> "tuple[dict[str, Run], Path]":
    """Label a recording by colour and by depth; return both runs by name, and the labelled session."""
    if several := recordings_in(recording):
        raise CloudError(f"{recording} is a folder of {len(several)} sessions; give one, e.g. {several[0]}")
    source = open_recording(recording, names=False)
    check_colour(source)
    by_colour = LabelChoices(by=COLOUR).work()
    _begin(out, recording)
    source, session = _as_session(source, recording, out)
    with progress("label by colour", len(source)) as advance:
        runs = {BY_COLOUR: by_colour(source, out / BY_COLOUR, advance)}
    choices = PredictChoices(
        weights=None, window_c=None, probabilities=False, everybody=False, again=None, learnt=None
    )
    by_depth = choices.work(source, out / BY_DEPTH)
    with progress("label by depth", len(source)) as advance:
        runs[BY_DEPTH] = by_depth(advance)
    return runs, session


def _begin(out: Path, recording: Path) -> None:
    """Start the folder, or check that an earlier run of this recording did."""
    from annotate.labelset.json_object import read_object

    marker, origin = out / MARKER, {"recording": str(recording.resolve())}
    check_folder_name(out)
    if not marker.is_file():
        if is_taken(out):
            raise ExistsError(f"{out} already exists; choose another folder")
        out.mkdir(parents=True, exist_ok=True)
        write_bytes(marker, jsons.dumps(origin).encode())
    elif read_object(marker) != origin:
        raise ExistsError(f"{out} is of another recording; choose another folder")


def _as_session(source: "Source", recording: Path, out: Path) -> "tuple[Source, Path]":
    """Return the recording as a session with its path: itself, or imported into the folder.

    A failed import takes the marker back, and then the empty folder.
    """
    from sensors.session.reader import Session

    if isinstance(source, Session):
        say(*source.notes, *doubts_of(source))
        return source, recording
    session = out / RECORDING
    if not session.is_file():
        try:
            write_session(source, session, overwrite=True)  # replaces the partial file of a killed run
        except CloudError:
            (out / MARKER).unlink()
            if not is_taken(out):
                out.rmdir()
            raise
    return open_recording(session, names=False), session


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
    """Return the commands to continue with, by their purpose. session: the labelled recording."""
    colour, depth = str(out / BY_COLOUR), str(out / BY_DEPTH)
    commands = {
        "both in the window": ["fix", colour, "--compare", depth, "--session", str(session)],
        "a depth network for this camera": ["adapt", colour, "--out", str(out / ADAPTED)],
    }
    return {purpose: shlex.join(["annotate-cloud", *words]) for purpose, words in commands.items()}
