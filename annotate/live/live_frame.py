"""Live frame: a rig's moment with all results, for the window, a robot or a stream."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from annotate.array_types import Float64
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.live.warning import LiveWarning
from annotate.person.extract import PersonMask
from annotate.segmentation.segmented_person import Segmentation
from sensors.recording.arrival_times import Event
from sensors.recording.frame_assembly import SyncedFrame
from sensors.recording.latest_value import LatestValue
from sensors.recording.stream_health import Health
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import RigCalibration


@dataclass(frozen=True, eq=False)
class BodyPose:
    """Stance of the labelled person, in the frame of the undistorted depth camera.

    names: of the joints (J,). joints_m: float64 (J, 3) metres. bones: pairs of indices of joints. facing_deg:
    azimuth of the camera about the trunk, 0 before the chest, 90 on the person's left; facing_sure, [0, 1].
    posture: one of ``annotate.posture.POSTURES``, with its probability.
    """

    names: tuple[str, ...]
    joints_m: Float64
    bones: tuple[tuple[int, int], ...]
    facing_deg: float
    facing_sure: float
    posture: str
    posture_sure: float


@dataclass(frozen=True)
class Labelling:
    """Functions of the live pipeline.

    label: a cloud, after the labels of the previous frame, as ``label_cloud``.
    stance: joints, facing and posture of the labelled person, None where they cannot be known.
    """

    label: Callable[[ThermalCloud, FrameLabels | None], tuple[Segmentation, PersonMask]]
    body_pose: Callable[[FrameLabels, Intrinsics], BodyPose | None]


@dataclass(frozen=True, eq=False)
class LiveFrame:
    """One labelled moment. moment: its images as they came. labels: over the cloud's undistorted depth image.

    latency_ms: from the depth image's arrival until all of this was there. complaints: those that stand.
    """

    synced: SyncedFrame
    cloud: ThermalCloud
    labels: FrameLabels
    body_pose: BodyPose | None
    health: Health
    warnings: tuple[LiveWarning, ...]
    latency_ms: float


class Rig(Protocol):
    """A ``LiveRig`` or a ``Playback``; documented there."""

    name: str
    calibration: RigCalibration
    frames: LatestValue[SyncedFrame]
    events: deque[tuple[int, Event]]
    error: Exception | None

    def start(self) -> None: ...
    def close(self) -> None: ...
    def record(self, path: Path, subject: str = "", overwrite: bool = False) -> None: ...
    def end_recording(self) -> Path | None: ...
    def mark(self, text: str) -> None: ...
    def health(self) -> Health: ...
