"""Let the virtual rig record: a session, its truth as a label set, and the suit that was worn."""

from collections.abc import Callable
from glob import escape
from math import isfinite, nan
from pathlib import Path

from annotate.labelset.atomic_folder import appearing
from annotate.labelset.label_set import MANIFEST, LabelSet
from annotate.suit.palette import suit_to_toml
from sensors.files.atomic import check_free, replacing, sweep
from sensors.rig.frame import RigFrame
from sensors.session.messages import PYROMETER, spot_message
from sensors.session.writer import SessionWriter
from synth.rig.paths import suit_path, truth_path
from synth.rig.truth import Truth, truth_labels
from synth.rig.virtual_rig import FLAG_CLOSED, VirtualRig


def simulate(rig: VirtualRig, out: Path, progress: Callable[[int], None], *, overwrite: bool = False) -> None:
    """Record all frames of the rig to ``out``, the truth and the suit beside it.

    They appear when all are done; a broken run leaves nothing. ``progress`` is called with 1 a frame.
    Raises ExistsError when one of them exists and ``overwrite`` is False.
    """
    truth_folder = truth_path(out)
    check_free(suit_path(out), overwrite)
    check_free(truth_folder, overwrite, folder=True)
    metadata = {
        "difficulty": rig.difficulty.name,
        "seed": str(rig.seed),
        "subjects": str(rig.subjects),
        "scene": rig.scene,
        "rig": rig.rig,
    }
    writer = SessionWriter(
        out, rig.calibration, rig.name, overwrite=overwrite, metadata=metadata, keep_partial=False
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    sweep(out.parent, f".{escape(suit_path(out).name)}.*.partial")
    with (
        appearing(truth_folder, MANIFEST, overwrite=overwrite) as unfinished,
        replacing(suit_path(out), overwrite) as suit,
        writer,
    ):
        suit.write_text(suit_to_toml(rig.suit), encoding="utf-8")
        info = {"source": rig.name, "made_by": "simulate"}
        truth = LabelSet.create(unfinished, rig.calibration.depth.undistorted(), info)
        for frame, known in rig.with_truth():
            _record(writer, frame, known)
            truth.write(truth_labels(frame, known, rig.calibration.depth))
            progress(1)


def _record(writer: SessionWriter, frame: RigFrame, known: Truth) -> None:
    """Write a frame, the thermal camera's closed flag and the pyrometer's reading."""
    writer.write(frame)
    if frame.thermal_c is None:
        writer.event(frame.stamp_ns, FLAG_CLOSED)
    if isfinite(known.spot_c):
        spot = spot_message(known.spot_c, nan, nan, frame.stamp_ns)
        writer.add(PYROMETER, spot, frame.stamp_ns)
