"""The recording that a label set was made from: where it lies, and its frames fused beside the labels."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.labelset.store import LabelSet
from sensors.errors import CloudError, FormatError
from sensors.importers.open_source import open_source
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration


class Fused(NamedTuple):
    """A labelled frame's points. frame: what was recorded, or None; remark: why that is missing, or ""."""

    cloud: ThermalCloud
    frame: RigFrame | None
    remark: str = ""


class Recorded:
    """Frames of a label set with the colours and temperatures of its recording.

    session: anything that ``open_source`` reads, or None: then clouds have depth alone. calibration: of the
    frames' images; the depth camera's is the undistorted one of the labels.
    Raises FormatError where the recording is not of these frames' size.
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
        """Calibration of the recording's cameras as recorded, or of the labels' depth camera alone."""
        return self._fuser.calibration

    @property
    def events(self) -> tuple[tuple[int, str], ...]:
        """(stamp in nanoseconds, text) of all that a session notes, by time."""
        return tuple(sorted(self._source.events)) if self._source else ()

    def fused(self, labels: FrameLabels) -> Fused:
        """Points of a labelled frame; what cannot be read of the recording is left out with a remark."""
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


def find_session(labels: LabelSet) -> Path | None:
    """The recording beside the label set: by the name of the manifest's source, or by the set's own name."""
    path = labels.path.resolve()
    name = labels.info.get("source")
    names = [name] if isinstance(name, str) and name and Path(name).name == name else []
    beside = [path.parent / f"{each}.mcap" for each in (*names, path.stem, path.name)]
    return next((file for file in beside if file.is_file()), None)
