"""Corrections of other frames, carried over to the frame on the desk (``correction.propagate``)."""

from collections.abc import Sequence

from annotate.array_types import UInt8
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction.correction import Correction
from annotate.correction.propagate import FRAMES_COMPARED, CorrectedFrame, propagate
from annotate.frame_labels import FrameLabels
from annotate.gui.scene import FrameScene


class CarryOver:
    """Carries corrections over. always: whether every frame that accepting opens gets them without a key."""

    def __init__(self, correction: Correction) -> None:
        self.always = False
        self._correction = correction
        self._clouds: dict[str, ThermalCloud] = {}

    def remember(self, scene: FrameScene) -> None:
        """Keep the cloud of a frame that is opened; those of the last FRAMES_COMPARED frames are kept."""
        self._clouds.pop(scene.labels.frame_id, None)
        self._clouds[scene.labels.frame_id] = scene.cloud
        while len(self._clouds) > FRAMES_COMPARED + 1:
            del self._clouds[next(iter(self._clouds))]

    def parts(self, target: FrameLabels, cloud: ThermalCloud, frame_ids: Sequence[str]) -> UInt8:
        """Parts (h, w) of a frame after the corrections of others, the nearest first."""
        frames = [
            CorrectedFrame(self._automatic(i), self._correction.frame(i), self._clouds.get(i))
            for i in frame_ids
        ]
        return propagate(frames, target, self._correction.labels.intrinsics, cloud)

    def _automatic(self, frame_id: str) -> FrameLabels:
        labels = self._correction.labels
        return labels.read(frame_id, original=labels.has_original(frame_id))
