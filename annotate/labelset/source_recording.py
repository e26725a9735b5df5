"""Recording of a label set: search for its file, and fusion of recorded frames with their labels."""

from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import RECORDING, LabelSet
from sensors.errors import CloudError, FormatError
from sensors.importers.open_source import open_source
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration, calibration_to_json
from sensors.session.reader import Session
from sensors.session.recognise import mcap_files


class Fused(NamedTuple):
    """Cloud of a labelled frame. frame: as recorded, or None with a remark on the reason."""

    cloud: ThermalCloud
    frame: RigFrame | None
    remark: str = ""


class Recorded:
    """Frames of a label set with the colours and temperatures of its recording.

    session: path that ``open_source`` reads; None = depth alone. Raises FormatError for a recording with
    another image size than the labels.
    """

    def __init__(self, labels: LabelSet, session: Path | None) -> None:
        self._source = open_source(session) if session else None
        # A label set's depth images are undistorted already.
        self._bare = Fuser(RigCalibration(labels.intrinsics))
        self._fuser = Fuser(self._source.calibration) if self._source else self._bare
        if self._fuser.camera.shape != labels.intrinsics.shape:
            raise FormatError(
                f"{session} has images of {self._fuser.camera.shape}, {labels.path} of "
                f"{labels.intrinsics.shape}; give the session that was labelled"
            )

    @property
    def calibration(self) -> RigCalibration:
        """Return the calibration as recorded, or of the labels' depth camera alone."""
        return self._fuser.calibration

    @property
    def events(self) -> tuple[tuple[int, str], ...]:
        """Return (stamp in nanoseconds, text) of all notes of a session, by time."""
        return tuple(sorted(self._source.events)) if self._source else ()

    def fused(self, labels: FrameLabels) -> Fused:
        """Fuse a labelled frame; if the recorded frame is unreadable or another one, depth alone, with a
        remark.
        """
        why = ""
        if self._source is not None:
            try:
                frame = self._source.frame(int(labels.frame_id))
                cloud = self._fuser.fuse_frame(frame)
                if np.array_equal(cloud.depth_mm, labels.depth_mm):
                    return Fused(cloud, frame)
                why = "no colour or temperature: the session shows another depth image"
            except (CloudError, ValueError, IndexError, OSError) as error:
                why = f"no colour or temperature: {error}"
        return Fused(self._bare.fuse(labels.depth_mm), None, why)


def recording_entry(path: Path | None) -> dict[str, Any]:
    """Return the manifest entry about a recording: its name, and a file's size."""
    if path is None:
        return {}
    size = {"bytes": path.stat().st_size} if path.is_file() else {}
    return {RECORDING: {"name": path.resolve().name, **size}}


def find_session(labels: LabelSet) -> Path | None:
    """Return the recording beside the label set, or None.

    Matched by the manifest's name and size, else by its SHA-256, else by the name of the source or of the
    set.
    """
    folder, entry = labels.path.resolve().parent, labels.info.get(RECORDING)
    name, size = (entry.get("name"), entry.get("bytes")) if isinstance(entry, dict) else (None, None)
    if isinstance(name, str) and _is_plain(name) and (named := folder / name).exists():
        fits = not named.samefile(labels.path) and (size is None or named.stat().st_size == size)
        if fits and named.is_file() == (size is not None):
            return named
    if (same := _by_checksum(labels, folder, size)) is not None:
        return same
    source = labels.info.get("source")
    names = [source] if isinstance(source, str) and _is_plain(source) else []
    beside = [folder / f"{each}.mcap" for each in (*names, labels.path.resolve().stem, labels.path.name)]
    return next((file for file in beside if file.is_file()), None)


def _is_plain(name: str) -> bool:
    """Return whether a name from a manifest is a plain file name, without folders."""
    return bool(name) and name != ".." and Path(name).name == name


def _by_checksum(labels: LabelSet, folder: Path, size: int | None) -> Path | None:
    """Return the session of a folder with the manifest's SHA-256; only files of equal size, name and
    calibration are hashed.
    """
    wanted = labels.info.get("sha256")
    if not isinstance(wanted, str):
        return None
    for file in mcap_files(folder).sessions:
        if size is not None and file.stat().st_size != size:
            continue
        with suppress(CloudError, OSError):
            session = Session(file)
            alike = calibration_to_json(session.calibration) == labels.info.get("calibration")
            if alike and session.name == labels.source and session.sha256 == wanted:
                return file
    return None
