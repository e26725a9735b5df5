"""Let the virtual rig record: a session, its truth as a label set, and the suit that was worn."""

import shutil
from collections.abc import Callable
from pathlib import Path

from annotate.store import LabelSet
from annotate.suit import suit_to_toml
from sensors.atomic import write_bytes
from sensors.errors import ExistsError
from sensors.session import SessionWriter
from synth.rig import VirtualRig, truth_labels


def truth_path(session: Path) -> Path:
    """Where the truth of a simulated session lies."""
    return session.with_name(session.name + ".truth")


def suit_path(session: Path) -> Path:
    """Where the palette of a simulated session's suit lies."""
    return session.with_name(session.name + ".suit.toml")


def simulate(rig: VirtualRig, out: Path, progress: Callable[[int], None], *, overwrite: bool = False) -> None:
    """Record all frames of the rig to ``out``, ``out.truth/`` and ``out.suit.toml``.

    They appear when all are done; a broken run leaves nothing. ``progress`` is called with 1 a frame.
    Raises ExistsError when one of them exists and ``overwrite`` is False.
    """
    truth_folder = truth_path(out)
    if not overwrite and truth_folder.exists():
        raise ExistsError(f"{truth_folder} exists already; choose another name or pass --overwrite")
    unfinished = truth_folder.with_name(truth_folder.name + ".partial")
    shutil.rmtree(unfinished, ignore_errors=True)
    metadata = {"difficulty": rig.difficulty.name, "seed": str(rig.seed), "subjects": str(rig.subjects)}
    writer = SessionWriter(
        out, rig.calibration, rig.name, overwrite=overwrite, metadata=metadata, keep_partial=False
    )
    try:
        with writer:
            truth = LabelSet.create(
                unfinished, rig.calibration.depth.undistorted(), {"source": rig.name, "made_by": "simulate"}
            )
            for frame, known in rig.with_truth():
                writer.write(frame)
                truth.write(truth_labels(frame, known))
                progress(1)
            write_bytes(suit_path(out), suit_to_toml(rig.suit).encode())
        shutil.rmtree(truth_folder, ignore_errors=True)
        unfinished.replace(truth_folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
