"""Factory calibration of a Kinect v2: the infrared camera, and how depth maps to colour.

libfreenect2's ``Registration`` maps mirror images: its baseline, shift_m, is +52 mm where the pose of
unmirrored images has x = -52 mm (iai_kinect2's calibrations).
"""

from typing import NamedTuple

from sensors.rig.camera import Intrinsics


class KinectColorParams(NamedTuple):
    """Factory calibration of a Kinect v2's colour camera (libfreenect2's ColorCameraParams).

    f, cx, cy: pixels. shift_d, shift_m: distance of the projection plane and baseline, mm. mx, my: cubic
    coefficients for x and y in the order x3y0 x0y3 x2y1 x1y2 x2y0 x0y2 x1y1 x1y0 x0y1 x0y0.
    """

    f: float
    cx: float
    cy: float
    shift_d: float
    shift_m: float
    mx: tuple[float, ...]
    my: tuple[float, ...]
    width: int = 1920
    height: int = 1080


KINECT2_DEPTH = Intrinsics(
    *(512, 424, 365.150208, 365.150208, 253.9832, 211.093994),
    k1=0.0922871977,
    k2=-0.266797304,
    k3=0.0901915208,
)
"""Infrared camera of a Kinect v2, for unmirrored images. The numbers are one real unit's for its mirrored
images: the two differ by 3 pixels of cx, and units by up to 12."""
KINECT2_PINHOLE = KINECT2_DEPTH.undistorted()  # the camera of undistorted depth images
KINECT2_COLOR = KinectColorParams(  # of the same unit, for mirrored images of depth and colour
    *(1081.37207, 959.5, 539.5, 863.0, 52.0),
    mx=(
        *(5.23260387e-4, 2.66473307e-5, 7.26420622e-5, 3.86019994e-4, -8.80247826e-5),
        *(-8.62425368e-5, 2.60630302e-4, 0.640707493, 0.00462980801, 0.152766302),
    ),
    my=(
        *(1.641368e-5, 7.05449376e-4, 4.68305807e-4, 3.74624688e-5, -9.42075494e-5),
        *(2.11564999e-4, 6.66987689e-5, -0.00469533494, 0.640462875, 0.035591729),
    ),
)
