"""The verbs ``info`` and ``validate``: the contents of a path, and its problems."""

from collections import Counter
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument

from cli.console import Block, Json, block, cell, event_lines, facts, finish, table
from cli.remedies import remedied
from cli.sessions import recordings_in
from sensors.errors import CloudError
from sensors.importers.open_source import judged_notes, open_source

if TYPE_CHECKING:
    from annotate.correction.audit import Audit, PersonWork
    from annotate.labelset.journal import Journal
    from annotate.labelset.label_set import LabelSet
    from sensors.rig.frame import FrameSource
    from sensors.session.reader import Session

EARLIEST_NS = 946_684_800 * 10**9  # 2000, from 1970: earlier times are counted from a device's start
DOUBTFUL = "doubtful"  # first word of notes on doubts
FOLDER = "folder of recordings"
Held = Annotated[
    Path, Argument(help="Session or folder of sessions, label set, dataset, motion, or what import reads.")
]
Contents = tuple[dict[str, Any], Block]  # as JSON, and as lines for people
Problems = tuple[list[str], list[str]]  # problems and doubts


def info(path: Held, json: Json = False) -> None:
    """Show the contents of a path; for a label set, also the work of each person on it."""
    from annotate.labelset import dataset, label_set

    if (path / label_set.MANIFEST).exists() or any(path.glob(f"*/{label_set.MANIFEST}")):
        result, text = _labels(label_set.LabelSet.open(path))
    elif (path / dataset.MANIFEST).exists():
        shards = dataset.Dataset.open(path)
        result = {"kind": "dataset", "shards": len(shards.shards), **shards.info}
        result["scheme"] = shards.scheme.name
        text = facts(result)
    elif files := recordings_in(path, foreign=True):
        result, text = _folder(files)
    else:
        result, text = _motion(path) or _source(path)
    finish(result, json, text)


def validate(path: Held, json: Json = False) -> None:
    """Check every frame; print warnings about depth; exit with 1 on a problem."""
    from annotate.labelset import dataset
    from annotate.labelset import label_set as store

    doubts: list[str] = []
    if (path / store.MANIFEST).exists():
        problems = store.validate(store.LabelSet.open(path))
    elif (path / dataset.MANIFEST).exists():
        problems = dataset.validate(dataset.Dataset.open(path))
    elif files := recordings_in(path, foreign=True):
        problems, doubts = _folder_problems(files)
    else:
        problems, doubts = _source_problems(path)
    verdict = [] if problems else [f"{path}: no {'other ' if doubts else ''}problems found"]
    result = {"ok": not problems, "problems": problems, **({"doubts": doubts} if doubts else {})}
    finish(result, json, *doubts, *problems, *verdict)
    if problems:
        raise typer.Exit(1)


def _motion(path: Path) -> Contents | None:
    if path.suffix != ".npz":
        return None
    from cli.verbs.motion import motion_info
    from synth.motion.library import is_motion

    return motion_info(path) if is_motion(path) else None


def _source(path: Path) -> Contents:
    from sensors.session.reader import Session

    source = open_source(path)
    result: dict[str, Any] = {"kind": type(source).__name__, "name": source.name, "frames": len(source)}
    if source.subject:
        result["subject"] = source.subject
    if (started := _started(source)) is not None:
        result["started"] = started
    short, texts = dict(result), list[str]()
    if isinstance(source, Session):
        result |= {"truncated": source.truncated, "being_recorded": source.is_being_recorded}
        result["streams"] = {
            topic: {"messages": s.count, "per_second": round(s.rate_hz, 2)}
            for topic, s in source.streams.items()
        }
        short |= _recording(source)
        texts.append(_streams(source))
    notes = result["notes"] = [remedied(note) for note in judged_notes(source)]
    return result, block(facts(short), *texts, block(*notes, gap="\n"))


def _recording(session: "Session") -> dict[str, Any]:
    """Return duration, state, events and pyrometer of a session, as readable values."""
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
    """Return the local date and time of the first frame; None where frames have no date."""
    if not len(source) or (first_ns := int(source.times_ns[0])) < EARLIEST_NS:
        return None
    return datetime.fromtimestamp(first_ns / 1e9).astimezone().isoformat(" ", "seconds")


def _streams(session: "Session") -> Block:
    """Return a table of the streams, each with size and focal length of its camera."""
    from sensors.session.messages import COLOR, COUNTS, DEPTH, INFRARED, THERMAL

    rig, rows = session.calibration, []
    depth, thermal = rig.depth, rig.thermal
    cameras = {DEPTH: depth, INFRARED: depth, THERMAL: thermal, COUNTS: thermal, COLOR: rig.color}
    for topic, stream in session.streams.items():
        camera = cameras.get(topic)
        lens = (None, None) if camera is None else (f"{camera.width} x {camera.height}", camera.fx)
        rows.append((topic, stream.count, stream.rate_hz, *lens))
    return table(("stream", "messages", "per second", "size, px", "focal length, px"), rows)


def _folder(files: list[Path]) -> Contents:
    found: dict[str, dict[str, Any]] = {}
    for file in files:
        try:
            source = open_source(file)
            span_s = float(source.times_ns[-1] - source.times_ns[0]) * 1e-9 if len(source) else 0.0
            found[file.name] = {
                "kind": type(source).__name__,
                "name": source.name,
                "frames": len(source),
                "duration_s": round(span_s, 3),
                "notes": [remedied(note) for note in source.notes],
            }
        except (CloudError, OSError) as error:
            found[file.name] = {"error": remedied(error)}
    rows = [
        (name, one["kind"], one["name"], one["frames"], cell(one["duration_s"], "s"))
        for name, one in found.items()
        if "error" not in one
    ]
    lines = [
        f"{name}: {text}"
        for name, one in found.items()
        for text in ([one["error"]] if "error" in one else one["notes"])
    ]
    head = facts({"kind": FOLDER, "recordings": len(files)})
    columns = ("file", "kind", "name", "frames", "duration")
    return {"kind": FOLDER, "recordings": found}, block(head, table(columns, rows), *lines)


def _folder_problems(files: list[Path]) -> Problems:
    problems, doubts = list[str](), list[str]()
    for file in files:
        try:
            wrong, doubtful = _source_problems(file)
        except (CloudError, OSError) as error:
            wrong, doubtful = [remedied(error)], []
        problems += [f"{file.name}: {problem}" for problem in wrong]
        doubts += [f"{file.name}: {doubt}" for doubt in doubtful]
    return problems, doubts


def _source_problems(path: Path) -> Problems:
    from annotate.cloud.fuse import Fuser
    from annotate.label_recording import calibrated
    from sensors.session.reader import Session

    source = open_source(path)
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
        doubts = [remedied(note) for note in judged_notes(source) if note.startswith(DOUBTFUL)]
    except CloudError:
        doubts = []  # an unreadable frame is among the problems
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


def _labels(labels: "LabelSet") -> Contents:
    from annotate.correction.audit import audit
    from annotate.labelset.journal import Journal

    journal, frames = Journal.of(labels.path, labels.scheme), len(labels.frame_ids)
    states, pixels = _counted(labels, journal)
    head = {"kind": "label set", "scheme": labels.scheme.name, "frames": frames, "states": states}
    source, steps = labels.info.get("source", ""), labels.info.get("steps", {})
    result: dict[str, Any] = {**head, "pixels": pixels, "source": source, "steps": steps}
    texts: list[str] = [
        facts({**head, "source": source, "steps": list(steps)}),
        table(("part", "pixels per frame"), [(part, n / max(1, frames)) for part, n in pixels.items()]),
    ]
    if journal and (found := audit(labels, journal)).people:
        result["audit"] = found.to_json()
        texts += [_people(found), *(_parts(person) for person in found.people if person.parts)]
        texts += [f"rejected {frame_id}: {reason}" for frame_id, reason in found.rejected.items()]
    return result, block(*texts)


def _counted(labels: "LabelSet", journal: "Journal") -> tuple[dict[str, int], dict[str, int]]:
    """Return numbers of frames by state, and of pixels by part."""
    import numpy as np

    from annotate.correction.replay import STATE_NAMES, state_of
    from annotate.scheme.scheme import BACKGROUND_PART

    states, pixels = Counter[str](), np.zeros(256, np.int64)
    for frame_id in labels.frame_ids:
        strokes = journal.strokes(frame_id)
        before = labels.status(frame_id, bool(strokes) and labels.has_original(frame_id))
        truth = before == "truth" and not strokes
        states["truth" if truth else STATE_NAMES[state_of(strokes, before)]] += 1
        # Only this image is read, because the others take most of the time.
        pixels += np.bincount(labels.parts(frame_id).ravel(), minlength=256)
    classes = (BACKGROUND_PART, *labels.scheme.parts)
    return dict(states), {part.name: int(pixels[part.id]) for part in classes}


def _people(found: "Audit") -> Block:
    names = ("person", "frames", "accepted", "untouched", "s median", "s p90", "strokes", "undos", "changed")
    rows = [
        (
            *(person.who, person.frames, person.accepted, f"{person.accepted_untouched:.0%}"),
            *(f"{person.seconds_median:.1f}", f"{person.seconds_p90:.1f}"),
            *(person.strokes, person.undos, f"{person.changed:.1%}"),
        )
        for person in found.people
    ]
    return table(names, rows, "Corrections")


def _parts(person: "PersonWork") -> Block:
    rows = [
        (name, work.strokes, f"{work.seconds:.1f}", work.gained_px, work.lost_px)
        for name, work in person.parts.items()
    ]
    return table(("part", "strokes", "seconds", "px gained", "px lost"), rows, f"Parts, {person.who}")
