"""``FrameSource``: the protocol of sessions, folders, clouds, the virtual rig and devices."""

from collections.abc import Iterator
from typing import Protocol

from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration


class FrameSource(Protocol):
    """A finite or endless stream of synchronised rig frames.

    Nothing downstream depends on which kind it is.
    """

    @property
    def name(self) -> str:
        """Short human name: a file's stem or a device's serial."""
        ...

    @property
    def calibration(self) -> RigCalibration:
        """Calibration valid for every frame of the source."""
        ...

    def __iter__(self) -> Iterator[RigFrame]:
        """Yield frames in the order of their depth timestamps."""
        ...
