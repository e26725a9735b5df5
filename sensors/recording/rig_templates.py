"""Four common rigs by name: their cameras by data sheet, how they are mounted, and the plate that suits them.

The calibrations are starting points: they name image sizes and roughly where everything is. Measure your
own with the hole plate before you label.
"""

from dataclasses import dataclass

import numpy as np

from sensors.calibrate.hole_plate import HolePlate
from sensors.calibration_files.kinect2_factory import KINECT2_DEPTH
from sensors.errors import DeviceError
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, RigCalibration


@dataclass(frozen=True)
class RigTemplate:
    """A rig that people build.

    devices: addresses, depth camera first. calibration: by data sheet, the thermal camera just above the
    depth camera. plate: the hole plate that suits; plate_m: nearest and farthest distance at which all
    cameras see its holes. depth_sd_mm: noise of a depth reading at 2 m. remark: what to know of this rig.
    """

    name: str
    title: str
    devices: tuple[str, ...]
    calibration: RigCalibration
    plate: HolePlate
    plate_m: tuple[float, float]
    depth_sd_mm: float
    remark: str


KINECT_COLOR = Intrinsics(
    1920, 1080, 1081.37207, 1081.37207, 959.5, 539.5,
    0.0562684, -0.0741991, 0.00142508, -0.00169517, 0.0241077,
)  # fmt: skip
"""Colour camera of a real Kinect v2 (serial 196605135147 of iai_kinect2, Apache-2.0)."""
_COLOR_TURN = np.array([
    [0.9997988392329585, -0.016871339005902476, -0.010846150864558944],
    [0.01689110100918102, 0.9998558333036965, 0.0017330075788897306],
    [0.010815349052457943, -0.0019158623955699537, 0.9999396770286471],
])  # fmt: skip
COLOR_FROM_DEPTH = Pose(_COLOR_TURN, np.array([-0.05205248, -0.00046314, 0.00088807]))
"""Pose of the same unit's colour camera, 52 mm to the right of the depth camera as seen from behind. It holds
for unmirrored images, as the driver delivers them: iai_kinect2 flips libfreenect2's before calibrating."""
OPTRIS = Intrinsics(160, 120, 110.1, 110.1, 80.3, 59.2, -0.19, 0.04)
"""Optris PI200 with its 72 degree lens."""
LEPTON = Intrinsics(160, 120, 158.7, 158.7, 79.5, 59.5, -0.26, 0.06)
"""FLIR Lepton 3.5: 57 degrees wide (data sheet), distorted by 13 % in the corners (from memory)."""
BOSON = Intrinsics(640, 512, 408.0, 408.0, 319.5, 255.5, -0.30, 0.055)
"""FLIR Boson 640 with its 4.9 mm lens: 95 degrees wide, 12 um a pixel (both from memory)."""
AZURE_DEPTH = Intrinsics(640, 576, 503.9, 503.7, 321.0, 328.5, -0.3295, 0.1388, k3=-0.03205)
"""Narrow view of a real Azure Kinect, its rational lens as the polynomial that fits to the corners within
0.14 %. Source: a calibration published in issue 1488 of microsoft/Azure-Kinect-Sensor-SDK."""
AZURE_COLOR = Intrinsics(1920, 1080, 919.5, 919.4, 972.4, 560.5, 0.1019, -0.0711, k3=0.0124)
"""Colour camera of the same unit."""
BOLT_COLOR = Intrinsics(1920, 1080, 1144.0, 1144.0, 959.5, 539.5, 0.08, -0.05)
"""Orbbec Femto Bolt: 80 x 51 degrees (data sheet); distortion untuned."""
D455_DEPTH = Intrinsics(848, 480, 417.0, 417.0, 423.5, 239.5)
"""RealSense D455, rectified, in the mode that its maker recommends."""
D455_COLOR = Intrinsics(1280, 720, 629.6, 629.6, 639.5, 359.5, -0.0557, 0.0603, -0.00098, -0.00085, -0.0161)
"""Colour camera of a real D455 (data set ABC-iRobotics/Hand_Tools), the middle of its image."""


def _pose(right_m: float, down_m: float, forward_m: float, tilt_deg: float = 0.0) -> Pose:
    """camera_from_depth: where the depth camera lies, from a camera that looks ``tilt_deg`` down."""
    cosine, sine = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    turn = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    return Pose(turn, np.array([right_m, down_m, forward_m]))


REFERENCE = "kinect2-optris"
"""The rig that everything else is compared with."""
TEMPLATES = {
    one.name: one
    for one in (
        RigTemplate(
            REFERENCE,
            "Kinect v2 and Optris PI200",
            ("kinect2:", "optris-direct:/path/to/generic.xml"),
            RigCalibration(
                KINECT2_DEPTH, KINECT_COLOR, COLOR_FROM_DEPTH, OPTRIS, _pose(0.012, 0.06, -0.01, -2.0)
            ),
            HolePlate(),
            (0.75, 1.15),
            2.0,
            "the reference: all figures of the documentation are of this rig",
        ),
        RigTemplate(
            "d455-lepton",
            "RealSense D455 and FLIR Lepton 3.5",
            ("realsense:?size=848x480&color=1280x720&rate=30", "lepton:/dev/video0"),
            RigCalibration(D455_DEPTH, D455_COLOR, _pose(-0.059, 0.0, 0.0), LEPTON, _pose(0.048, 0.04, 0.0)),
            HolePlate(),
            (0.85, 1.3),
            8.0,
            "switch the projector off for the plate (laser=0 in the address): its dots hide the holes; every "
            "third depth image has temperatures",
        ),
        RigTemplate(
            "bolt-lepton",
            "Orbbec Femto Bolt and FLIR Lepton 3.5",
            ("orbbec:", "lepton:/dev/video0"),
            RigCalibration(
                AZURE_DEPTH, BOLT_COLOR, _pose(-0.032, -0.002, 0.004, -6.0), LEPTON, _pose(0.0, 0.04, 0.0)
            ),
            HolePlate(),
            (0.85, 1.3),
            3.0,
            "let it warm up for 45 minutes; every third depth image has temperatures",
        ),
        RigTemplate(
            "azure-boson",
            "Azure Kinect and FLIR Boson 640, 4.9 mm",
            ("azure:", "boson:/dev/video0"),
            RigCalibration(
                AZURE_DEPTH, AZURE_COLOR, _pose(-0.032, -0.002, 0.004, -6.0), BOSON, _pose(0.0, 0.06, 0.0)
            ),
            HolePlate(pitch_m=0.025, hole_m=0.015),
            (0.6, 1.0),
            3.0,
            "let it warm up for 45 minutes; a Boson without radiometry gives counts, not temperatures",
        ),
    )
}  # fmt: skip
"""The rigs by name. Depth noise at 2 m: Fankhauser et al. 2015 (Kinect v2); the error of stereo matching of
0.08 pixels (D455); from memory (Azure Kinect and Femto Bolt, whose makers state 17 mm at most)."""


def template_named(name: str) -> RigTemplate:
    """The rig of that name. Raises DeviceError."""
    if name not in TEMPLATES:
        raise DeviceError(f"no rig is named {name!r}; use {', '.join(TEMPLATES)}")
    return TEMPLATES[name]
