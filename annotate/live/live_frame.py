"""Live frame: a synchronised frame of a rig with its labels, body pose and warnings."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

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
    """Joints, facing and posture of the labelled person, in the frame of the undistorted depth camera.

    names: of the joints. joints_m: (J, 3). bones: pairs of joint indices. facing_deg: azimuth of the camera
    about the trunk, 0 in front of the chest, 90 on the person's left. posture: one of
    ``annotate.posture.POSTURES``, "" where it is unclear. facing_sure, posture_sure: probabilities.
    joint_quality: by column, values by joint; empty from networks that do not give it.
    """

    names: tuple[str, ...]
    joints_m: Float64
    bones: tuple[tuple[int, int], ...]
    facing_deg: float
    facing_sure: float
    posture: str
    posture_sure: float
    joint_quality: dict[str, dict[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Labelling:
    """Functions of the live pipeline.

    label: labels a cloud, given the previous labels or None, as ``label_cloud``. body_pose: returns the pose
    of the labelled person, or None.
    """

    label: Callable[[ThermalCloud, FrameLabels | None], tuple[Segmentation, PersonMask]]
    body_pose: Callable[[FrameLabels, Intrinsics], BodyPose | None]


@dataclass(frozen=True, eq=False)
class LiveFrame:
    """Labelled frame of a running rig.

    synced: the rig's images. labels: of the cloud's undistorted depth image. latency_ms: from the arrival of
    the depth image to the end of labelling.
    """

    synced: SyncedFrame
    cloud: ThermalCloud
    labels: FrameLabels
    body_pose: BodyPose | None
    health: Health
    warnings: tuple[LiveWarning, ...]
    latency_ms: float


class Rig(Protocol):
    """Protocol of a running rig: ``LiveRig`` of devices, or ``Playback`` of a recording."""

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
