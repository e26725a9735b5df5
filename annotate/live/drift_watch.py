"""Correction of a live thermal camera by the pyrometer, as ``Session`` corrects a recorded one."""

from dataclasses import replace

import numpy as np

from sensors.recording.frame_assembly import SyncedFrame
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration
from sensors.rig.thermal_reference import ThermalReference

EVERY_S = 0.2  # s between kept readings: two minutes of them; untuned
AGAIN_S = 10.0  # s between two searches for the pyrometer's spot in the image; untuned


class DriftWatch:
    """Corrector of live temperatures by the pyrometer, active once its spot in the thermal image is known."""

    def __init__(self, calibration: RigCalibration) -> None:
        self._reference = ThermalReference(calibration.thermal.fx) if calibration.thermal else None
        self._spot: int | None = None
        self._added_s = self._located_s = -np.inf

    def corrected(self, synced: SyncedFrame, frame: RigFrame) -> RigFrame:
        """Return the frame with corrected temperatures; unchanged while the spot is unknown.

        Call in the order of arrival, because the correction uses the readings so far.
        """
        reference, now_s = self._reference, synced.arrival_ns * 1e-9
        if reference is None or frame.thermal_c is None:
            return frame
        if now_s - self._added_s >= EVERY_S:
            self._added_s = now_s
            reference.add(now_s, synced.spot_c, frame.thermal_c)
        if now_s - self._located_s >= AGAIN_S:
            self._located_s = now_s
            self._spot = reference.spot()
        if self._spot is None:
            return frame
        offset_k = reference.offsets_k(self._spot, np.array([now_s]))[0]
        return replace(frame, thermal_c=frame.thermal_c + np.float32(offset_k))
