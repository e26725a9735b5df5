"""Let the virtual rig record: a session, its truth as a label set, and the suit that was worn."""

import shutil
from collections.abc import Callable
from glob import escape
from math import isfinite, nan
from pathlib import Path

from annotate.labelset.store import MANIFEST, LabelSet
from annotate.suit.palette import suit_to_toml
from sensors.errors import ExistsError
from sensors.files.atomic import check_free, replacing, sweep, temporary_of
from sensors.session.messages import PYROMETER, spot_message
from sensors.session.writer import SessionWriter
from synth.rig.paths import suit_path, truth_path
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import FLAG_CLOSED, VirtualRig


def simulate(rig: VirtualRig, out: Path, progress: Callable[[int], None], *, overwrite: bool = False) -> None:
    """Record all frames of the rig to ``out``, the truth and the suit beside it.

    They appear when all are done; a broken run leaves nothing. ``progress`` is called with 1 a frame.
    Raises ExistsError when one of them exists and ``overwrite`` is False.
    """
    truth_folder = truth_path(out)
    unfinished = temporary_of(truth_folder)
    for path in (suit_path(out), truth_folder):
        check_free(path, overwrite)
        _check_own(path)
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
    try:
        with replacing(suit_path(out)) as suit, writer:
            suit.write_text(suit_to_toml(rig.suit), encoding="utf-8")
            for made in (truth_folder, suit_path(out)):
                sweep(out.parent, f".{escape(made.name)}.*.partial")
            truth = LabelSet.create(
                unfinished, rig.calibration.depth.undistorted(), {"source": rig.name, "made_by": "simulate"}
            )
            for frame, known in rig.with_truth():
                writer.write(frame)
                if frame.thermal_c is None:
                    writer.event(frame.stamp_ns, FLAG_CLOSED)
                if isfinite(known.spot_c):
                    spot = spot_message(known.spot_c, nan, nan, frame.stamp_ns)
                    writer.add(PYROMETER, spot, frame.stamp_ns)
                truth.write(truth_labels(frame, known, rig.calibration.depth))
                progress(1)
        shutil.rmtree(truth_folder, ignore_errors=True)
        unfinished.replace(truth_folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _check_own(path: Path) -> None:
    if path.is_dir() and not (path / MANIFEST).is_file():
        raise ExistsError(f"{path} was not made by simulate (it has no {MANIFEST}); remove it yourself")
