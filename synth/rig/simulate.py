"""Recording of a virtual rig: a session, the true labels as a label set, and the suit."""

from collections.abc import Callable
from glob import escape
from math import isfinite, nan
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sensors.rig.frame import RigFrame
    from sensors.session.writer import RepeatableWriter
    from synth.rig.truth import Truth
    from synth.rig.virtual_rig import VirtualRig


def truth_path(session: Path) -> Path:
    """Return the folder of a simulated session's true labels: ``people.truth/`` beside ``people.mcap``."""
    return session.with_suffix(".truth")


def suit_path(session: Path) -> Path:
    """Return the palette file of a simulated session's suit."""
    return session.with_suffix(".suit.toml")


def simulate(
    rig: "VirtualRig", out: Path, progress: Callable[[int], None], *, overwrite: bool = False
) -> None:
    """Record all frames of the rig to ``out``, with truth and suit beside it; an interrupted run leaves no
    files.

    progress: called with 1 for each frame. Raises ExistsError if a file exists and ``overwrite`` is False.
    """
    from annotate.labelset.atomic_folder import appearing
    from annotate.labelset.cast_note import cast_note
    from annotate.labelset.label_set import MANIFEST, LabelSet
    from annotate.labelset.scheme_note import scheme_note
    from annotate.suit.palette import suit_to_toml
    from sensors.files.atomic import check_free, replacing, sweep
    from sensors.session.writer import RepeatableWriter
    from synth.rig.truth import truth_labels

    truth_folder = truth_path(out)
    check_free(suit_path(out), overwrite)
    check_free(truth_folder, overwrite, folder=True)
    metadata = {
        "difficulty": rig.difficulty.name,
        "seed": str(rig.seed),
        "subjects": str(rig.subjects),
        "scene": rig.scene,
        "rig": rig.rig,
        **cast_note(rig.cast),
    }
    writer = RepeatableWriter(out, rig.calibration, rig.name, overwrite=overwrite, metadata=metadata)
    out.parent.mkdir(parents=True, exist_ok=True)
    sweep(out.parent, f".{escape(suit_path(out).name)}.*.partial")
    with (
        appearing(truth_folder, MANIFEST, overwrite=overwrite) as unfinished,
        replacing(suit_path(out), overwrite) as suit,
        writer,
    ):
        suit.write_text(suit_to_toml(rig.suit), encoding="utf-8")
        info = {"source": rig.name, "made_by": "simulate", **cast_note(rig.cast), **scheme_note(rig.scheme)}
        truth = LabelSet.create(unfinished, rig.calibration.depth.undistorted(), info)
        for frame, known in rig.with_truth():
            _record(writer, frame, known)
            truth.write(truth_labels(frame, known, rig.calibration.depth, rig.scheme))
            progress(1)


def _record(writer: "RepeatableWriter", frame: "RigFrame", known: "Truth") -> None:
    from sensors.session.messages import PYROMETER, spot_message
    from synth.rig.virtual_rig import FLAG_CLOSED

    writer.write(frame)
    if frame.thermal_c is None:
        writer.event(frame.stamp_ns, FLAG_CLOSED)
    if isfinite(known.spot_c):
        writer.add(PYROMETER, spot_message(known.spot_c, nan, nan, frame.stamp_ns), frame.stamp_ns)
