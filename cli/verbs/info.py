"""The verbs ``info`` and ``validate``: what a path holds, and whether it is sound."""

from collections import Counter
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument

from cli.console import Json, cell, facts, finish, table
from cli.event_lines import event_lines
from cli.info_folder import folder_info, folder_problems, recordings_in
from cli.info_labels import labels_info
from sensors.errors import CloudError
from sensors.importers.open_source import judged_notes, open_source

EARLIEST_NS = 946_684_800 * 10**9
"""Nanoseconds from 1970 to 2000: earlier times are counted from a device's start."""
DOUBTFUL = "doubtful"
"""First word of notes on doubts."""

if TYPE_CHECKING:
    from sensors.rig.frame import FrameSource
    from sensors.rig.rig_calibration import RigCalibration
    from sensors.session.reader import Session

Held = Annotated[
    Path, Argument(help="Session or folder of sessions, label set, dataset, motion, or what import reads.")
]
Shown = tuple[dict[str, Any], str]
"""What a path holds: as JSON, and as lines for people."""


def info(
    path: Held,
    json: Json = False,
) -> None:
    """Show what a path holds; for a label set, also who corrected what."""
    from annotate.labelset import dataset, label_set

    if (path / label_set.MANIFEST).is_file() or label_set.label_sets_in(path):
        result, text = labels_info(label_set.LabelSet.open(path))
    elif (path / dataset.MANIFEST).is_file():
        shards = dataset.Dataset.open(path)
        result = {"kind": "dataset", "shards": len(shards.shards), **shards.info}
        text = facts(result)
    elif files := recordings_in(path):
        result, text = folder_info(files)
    else:
        result, text = _motion(path) or _source(path)
    finish(result, json, text)


def _motion(path: Path) -> Shown | None:
    """What a motion holds; None for anything else. Only archives are worth the imports."""
    if path.suffix != ".npz":
        return None
    from cli.verbs.motion import motion_info
    from synth.motion.library import is_motion

    return motion_info(path) if is_motion(path) else None


def _source(path: Path) -> Shown:
    source = open_source(path)
    # Imported after the file was recognised: a refusal costs no imports.
    from sensors.session.reader import Session

    result: dict[str, Any] = {"kind": type(source).__name__, "name": source.name, "frames": len(source)}
    if source.subject:
        result["subject"] = source.subject
    if (started := _started(source)) is not None:
        result["started"] = started
    short, texts = dict(result), []
    if isinstance(source, Session):
        result |= {"truncated": source.truncated, "being_recorded": source.is_being_recorded}
        result["streams"] = {
            topic: {"messages": s.count, "per_second": round(s.rate_hz, 2)}
            for topic, s in source.streams.items()
        }
        short |= _recording(source)
        texts.append(_streams(source))
    notes = judged_notes(source)
    result["notes"] = list(notes)
    return result, "\n\n".join([facts(short), *texts, "\n".join(notes)])


def _recording(session: "Session") -> dict[str, Any]:
    """Return duration, state, events and pyrometer of a session, for people."""
    import numpy as np

    from sensors.session.messages import DEPTH

    depth, known_c = session.streams[DEPTH], session.reference_c[np.isfinite(session.reference_c)]
    cut = "being recorded" if session.is_being_recorded else "cut off"
    found: dict[str, Any] = {
        "duration": cell((depth.count - 1) / depth.rate_hz if depth.rate_hz else 0.0, "s"),
        "recording": cut if session.truncated else "complete",
        "events": "; ".join(event_lines(Counter(text for _, text in session.events))) or "-",
    }
    return found | ({"pyrometer": cell(float(np.median(known_c)), "C, median")} if len(known_c) else {})


def _started(source: "FrameSource") -> str | None:
    """Return the date and time of the first frame, in this computer's time zone.

    None where frames have no date.
    """
    if not len(source) or (first_ns := int(source.times_ns[0])) < EARLIEST_NS:
        return None
    return datetime.fromtimestamp(first_ns / 1e9).astimezone().isoformat(" ", "seconds")


def _streams(session: "Session") -> str:
    columns = ("stream", "messages", "per second", "size, px", "focal length, px")
    rows = [
        (topic, stream.count, stream.rate_hz, *_camera(session.calibration, topic))
        for topic, stream in session.streams.items()
    ]
    return table(columns, rows)


def _camera(rig: "RigCalibration", topic: str) -> tuple[str | None, float | None]:
    """Size and focal length of the camera that a topic's images are of, as its calibration has them."""
    from sensors.session.messages import COLOR, COUNTS, DEPTH, INFRARED, THERMAL

    depth, thermal = rig.depth, rig.thermal
    cameras = {DEPTH: depth, INFRARED: depth, THERMAL: thermal, COUNTS: thermal, COLOR: rig.color}
    camera = cameras.get(topic)
    return (None, None) if camera is None else (f"{camera.width} x {camera.height}", camera.fx)


def validate(path: Held, json: Json = False) -> None:
    """Check every frame, print doubts about depth; exits with 1 if something is wrong."""
    from annotate.labelset import dataset
    from annotate.labelset import label_set as store

    doubts: list[str] = []
    if (path / store.MANIFEST).is_file():
        problems = store.validate(store.LabelSet.open(path))
    elif (path / dataset.MANIFEST).is_file():
        problems = dataset.validate(dataset.Dataset.open(path))
    elif files := recordings_in(path):
        problems, doubts = folder_problems(files, _source_problems)
    else:
        problems, doubts = _source_problems(path)
    verdict = [] if problems else [f"{path}: no {'other ' if doubts else ''}problems found"]
    result = {"ok": not problems, "problems": problems, **({"doubts": doubts} if doubts else {})}
    finish(result, json, "\n".join([*doubts, *problems, *verdict]))
    if problems:
        raise typer.Exit(1)


def _source_problems(path: Path) -> tuple[list[str], list[str]]:
    """Return the problems and the doubts of a source."""
    source = open_source(path)
    from annotate.cloud.fuse import Fuser
    from annotate.label_recording import calibrated
    from sensors.session.reader import Session

    problems = _session_problems(source, path) if isinstance(source, Session) else []
    fuser = Fuser(source.calibration)
    for index in range(len(source)):
        try:
            frame = source.frame(index)
            if (frame.depth_mm > 0).any():
                fuser.fuse_frame(calibrated(frame, source.calibration)[0])
            else:
                problems.append(f"frame {index:06d} has no depth reading")
        except CloudError as error:
            problems.append(f"frame {index:06d}: {error}")
    try:
        doubts = [note for note in judged_notes(source) if note.startswith(DOUBTFUL)]
    except CloudError:
        doubts = []  # a frame that cannot be read is a problem already
    return problems, doubts


def _session_problems(session: "Session", path: Path) -> list[str]:
    """Return the problems of a session's file: of its end, or of its records."""
    from sensors.session.repair import problems_of

    if session.is_being_recorded:
        return [f"{session.path} is being recorded; check it when the recording has ended"]
    if session.truncated:
        return [
            f"{path} is truncated: its end is lost; make its {len(session)} frames a whole session with: "
            f"annotate-cloud repair {session.path}"
        ]
    return [f"{session.path}: {problem}" for problem in problems_of(session.path)]
