"""Verbs that read recordings and labels of other tools, and write labels for them: import, export."""

from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, BadParameter, Option

from cli.console import Json, Names, Overwrite, finish, progress, say
from cli.remedies import remedied
from cli.scheme import names
from sensors.errors import FormatError
from sensors.files.atomic import check_free
from sensors.importers.open_source import CLOUDS, KINDS, judged_notes, open_source, opener_at
from sensors.importers.options import ImportOptions
from sensors.session.recording_file import SUFFIX
from synth.data_files import check_choice

if TYPE_CHECKING:
    from annotate.exchange.formats import Declared
    from annotate.labelset.label_set import LabelSet
    from sensors.rig.frame import FrameSource, RigFrame

FOXGLOVE = "foxglove"


@dataclass(frozen=True)
class Output:
    """Output of a verb. path: file or folder to write."""

    path: Path
    overwrite: bool
    json: bool

    def finish(self, result: dict[str, Any], text: str) -> None:
        """Print a result."""
        finish(result, self.json, f"{text} in {self.path}")


def formats() -> list[str]:
    """Return the names of the label formats to export."""
    from annotate.exchange.formats import FORMATS

    return [*FORMATS, FOXGLOVE]


def import_(
    source: Annotated[Path, Argument(help=f"Recording: {KINDS}. Labels: any output of export.")],
    out: Annotated[Path, Argument(help="out.mcap for a recording, a folder for labels.")],
    intrinsics: Annotated[
        Path | None,
        Option(help="Depth camera's intrinsics (JSON, YAML or text) in place of the source's own."),
    ] = None,
    depth_unit: Annotated[
        float | None, Option(help="Millimetres of a depth step: 1, 0.1 (D405), 0.2 (TUM), 1000 for metres.")
    ] = None,
    turn: Annotated[int, Option(help="Turn all images clockwise by 0, 90, 180 or 270 degrees.")] = 0,
    mirror: Annotated[
        bool, Option("--mirror", help="Mirror all images left to right, then turn them.")
    ] = False,
    subject: Annotated[str, Option(help="Name of the recorded person.")] = "",
    rate: Annotated[
        float | None, Option(help="Frames a second.", show_default="the recording's times, else 30")
    ] = None,
    topic: Annotated[
        list[str] | None, Option(help="Topic of a bag; given twice: topic of depth, then of colour.")
    ] = None,
    axes: Annotated[
        str, Option(help="Axes of a cloud: camera, y-up, ros, z-up or kinect.", show_default="by its points")
    ] = "",
    scheme: Annotated[
        str,
        Option(
            help="Scheme of the labels' parts: a shipped name or a file.",
            show_default="as exported, else paper",
            autocompletion=names,
        ),
    ] = "",
    map_: Annotated[
        Path | None,
        Option("--map", help="File (TOML, JSON) of other programs' class names or ids and our parts."),
    ] = None,
    by_hand: Annotated[
        bool, Option("--by-hand", help="A person corrected all labels: automatic frames count as accepted.")
    ] = False,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Import a recording (out.mcap) or another tool's labels (a folder); print all assumptions."""
    options = ImportOptions(intrinsics, depth_unit, turn, mirror, subject, rate, tuple(topic or ()), axes)
    output = Output(out, overwrite, json)
    if out.suffix.lower() == SUFFIX:
        if scheme or map_ or by_hand:
            raise BadParameter("--scheme, --map and --by-hand are for labels; name a folder as the output")
        _import_images(source, options, output)
        return
    if options != ImportOptions(intrinsics):
        raise BadParameter("--depth-unit to --axes are for recordings; name the output out.mcap")
    _import_labels(source, replace(_declared(intrinsics, scheme, map_), by_hand=by_hand), output)


def _declared(intrinsics: Path | None, scheme: str, map_: Path | None) -> "Declared":
    from annotate.exchange.class_names import read_map
    from annotate.exchange.formats import Declared
    from annotate.scheme.scheme_file import load_scheme

    return Declared(intrinsics, load_scheme(scheme) if scheme else None, read_map(map_) if map_ else {})


def export(
    labels: Annotated[Path, Argument(help="Label set.")],
    out: Annotated[Path, Argument(help="Folder to write; for foxglove a file, out.mcap.")],
    format_: Annotated[
        str,
        Option(
            "--format",
            help="pairs, mmseg, coco, cvat, pcd, ply, semantic-kitti, parquet, foxglove.",
            autocompletion=formats,
        ),
    ],
    session: Annotated[
        Path | None,
        Option(
            help="Recording of these labels, for foxglove's colours and temperatures (default: the one "
            "beside them). For pcd and ply, the labelled cloud: its own points get the labels."
        ),
    ] = None,
    names: Names = False,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write a label set in another tool's format; import reads it back, except foxglove."""
    from annotate.exchange.formats import FORMATS, export_labels
    from annotate.exchange.labelled_points import CLOUD_FORMATS, export_points
    from annotate.labelset.label_set import LabelSet
    from annotate.labelset.nameless import NamelessLabelSet

    check_choice("format", format_, (*FORMATS, FOXGLOVE))
    label_set = (LabelSet if names else NamelessLabelSet).open(labels)
    output = Output(out, overwrite, json)
    result: dict[str, Any] = {"frames": len(label_set), "format": format_, "path": str(out)}
    if format_ == FOXGLOVE:
        remarks = _export_foxglove(label_set, session, output)
        output.finish({**result, "remarks": remarks}, f"{len(label_set)} frames as {format_}")
        return
    if session is not None:
        if format_ not in CLOUD_FORMATS or session.suffix.lower() not in CLOUDS:
            raise BadParameter(
                f"only --format {FOXGLOVE} uses it, and {' and '.join(CLOUD_FORMATS)} of a cloud file",
                param_hint="--session",
            )
        done = export_points(label_set, session, format_, out, overwrite=overwrite)
        text = f"labels of {done.labelled} of {done.points} points of {session}"
        output.finish(result | done._asdict(), text)
        return
    with progress("export", len(label_set)) as advance:
        lost = export_labels(label_set, out, format_, advance, overwrite=overwrite)
    if lost:
        say(f"{format_} cannot carry {' and '.join(lost)}: left out")
    output.finish({**result, "left_out": list(lost)}, f"{len(label_set)} frames as {format_}")


def _export_foxglove(labels: "LabelSet", session: Path | None, output: Output) -> list[str]:
    """Write labels and their recording for Foxglove; return and print the remarks."""
    from annotate.foxglove.file import FoxgloveSource, export_foxglove
    from annotate.labelset.source_recording import find_session
    from eval.network.joints.joint_files import noted_joints

    check_free(output.path, output.overwrite, suffix=SUFFIX)
    if session is not None:
        opener_at(session)
    session = session or find_session(labels)
    source = FoxgloveSource(labels, session, partial(noted_joints, labels))
    with progress("export", len(labels)) as advance:
        remarks = export_foxglove(source, output.path, advance, overwrite=output.overwrite)
    say(*remarks)
    if session is None:
        say("no recording beside the labels, so no colours and temperatures; give one with --session")
    return remarks


def _import_images(source: Path, options: ImportOptions, output: Output) -> None:
    frames = open_source(source, options)
    streams, notes = write_session(frames, output.path, overwrite=output.overwrite)
    result = {"frames": streams["depth"], "streams": dict(streams), "notes": notes}
    output.finish(result, f"{streams['depth']} frames with {', '.join(sorted(streams))}")


def write_session(
    frames: "FrameSource", path: Path, *, overwrite: bool = False
) -> tuple[Counter[str], list[str]]:
    """Write a recording as a session, and print what was assumed; return frames by stream, and the notes."""
    from annotate.labelset.cast_note import cast_note
    from sensors.session.messages import SUBJECT
    from sensors.session.writer import RepeatableWriter

    notes, streams, faults = judged_notes(frames), Counter[str](), Counter[str]()
    metadata = {**({SUBJECT: frames.subject} if frames.subject else {}), **cast_note(frames.cast)}
    file = RepeatableWriter(path, frames.calibration, frames.name, overwrite=overwrite, metadata=metadata)
    with file as writer, progress("import", len(frames)) as advance:
        for frame in map(partial(_without_broken_color, faults), frames):
            writer.write(frame)
            images = {"color": frame.color_encoded, "thermal": frame.thermal_c, "infrared": frame.infrared}
            streams.update(["depth", *(name for name, image in images.items() if image is not None)])
            advance(1)
    notes = (*notes, *(f"colour of {count} frames is {fault}: left out" for fault, count in faults.items()))
    say(*notes, _camera_note(frames))
    return streams, [remedied(note) for note in notes]


def _without_broken_color(faults: Counter[str], frame: "RigFrame") -> "RigFrame":
    """Return a frame without its colour image if the image is broken, and count the fault."""
    from sensors.files.images import size_of_encoded

    if frame.color_encoded is None:
        return frame
    try:
        size_of_encoded(frame.color_encoded)
    except FormatError as error:
        faults[str(error)] += 1
        return replace(frame, color_encoded=None)
    return frame


def _camera_note(frames: "FrameSource") -> str:
    """Return a line on size, focal length and view of the depth camera, and places of the other cameras."""
    import numpy as np

    rig, depth = frames.calibration, frames.calibration.depth
    degrees = 2 * np.degrees(np.arctan(depth.width / 2 / depth.fx))
    lens = ", with a lens" if any(depth.distortion) else ""
    texts = [
        f"{depth.width}x{depth.height}, focal length {depth.fx:.1f} px ({degrees:.0f} degrees wide){lens}"
    ]
    for name, pose in (("colour", rig.color_from_depth), ("thermal", rig.thermal_from_depth)):
        if pose is not None:
            away_mm = 1000 * float(np.linalg.norm(pose.translation_m))
            texts.append(f"{name} camera {f'{away_mm:.0f} mm away' if away_mm > 0 else 'at the same place'}")
    return f"depth camera: {'; '.join(texts)}"


def _import_labels(source: Path, declared: "Declared", output: Output) -> None:
    from annotate.exchange.formats import import_labels

    with progress("import", None) as advance:
        labels, name, remarks = import_labels(
            source, output.path, advance, declared, overwrite=output.overwrite
        )
    say(*remarks)
    frames = len(labels)
    result = {"frames": frames, "streams": {"depth": frames, "parts": frames}, "format": name}
    result["scheme"] = labels.scheme.name
    output.finish(
        {**result, "path": str(output.path), "remarks": remarks}, f"{frames} labelled frames of {name}"
    )
