"""Verbs that read recordings and labels of other tools, and write labels for them: import, export."""

from collections import Counter
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from annotate.exchange.formats import FORMATS, export_labels, import_labels
from annotate.labelset.store import LabelSet
from cli.console import Json, Overwrite, finish, progress, say
from sensors.importers.open_source import KINDS, open_source
from sensors.rig.frame import RigFrame
from sensors.session.writer import SessionWriter

SESSION_SUFFIX = ".mcap"


def import_(
    source: Annotated[Path, Argument(help=f"Recording: {KINDS}. Labels: whatever export writes.")],
    out: Annotated[Path, Argument(help="out.mcap for a recording, a folder for labels.")],
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Import a recording (out.mcap) or another tool's labels (a folder)."""
    if out.suffix.lower() == SESSION_SUFFIX:
        _import_images(source, out, overwrite, json)
    else:
        _import_labels(source, out, overwrite, json)


def export(
    labels: Annotated[Path, Argument(help="Label set.")],
    out: Annotated[Path, Argument(help="Folder to write.")],
    format_: Annotated[
        str, Option("--format", help=f"{', '.join(FORMATS)}.", autocompletion=lambda: [*FORMATS])
    ],
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write a label set in another tool's format; import reads it back."""
    label_set = LabelSet.open(labels)
    with progress("export", len(label_set)) as advance:
        lost = export_labels(label_set, out, format_, advance, overwrite=overwrite)
    if lost:
        say(f"{format_} cannot carry {' and '.join(lost)}: left out")
    result = {"frames": len(label_set), "format": format_, "path": str(out), "left_out": list(lost)}
    finish(result, json, f"{len(label_set)} frames as {format_} in {out}")


def _import_images(source: Path, out: Path, overwrite: bool, json: bool) -> None:
    frames = open_source(source)
    streams = Counter[str]()
    with (
        SessionWriter(
            out, frames.calibration, frames.name, overwrite=overwrite, keep_partial=False
        ) as writer,
        progress("import", len(frames)) as advance,
    ):
        for frame in frames:
            writer.write(frame)
            streams.update(_streams_of(frame))
            advance(1)
    for note in frames.notes:
        say(note)
    result = {"frames": streams["depth"], "streams": dict(streams), "notes": list(frames.notes)}
    finish(result, json, f"{streams['depth']} frames with {', '.join(sorted(streams))} in {out}")


def _import_labels(source: Path, out: Path, overwrite: bool, json: bool) -> None:
    with progress("import", 0) as advance:
        labels, name = import_labels(source, out, advance, overwrite=overwrite)
    frames = len(labels)
    streams = {"depth": frames, "parts": frames}
    result = {"frames": frames, "streams": streams, "format": name, "path": str(out)}
    finish(result, json, f"{frames} labelled frames of {name} in {out}")


def _streams_of(frame: RigFrame) -> list[str]:
    images = {"color": frame.color_encoded, "thermal": frame.thermal_c, "infrared": frame.infrared}
    return ["depth", *(name for name, image in images.items() if image is not None)]
