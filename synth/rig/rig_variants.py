"""Twins of common rigs: a difficulty's faults on another depth or thermal camera."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from sensors.recording.rig_templates import AZURE_DEPTH, D455_DEPTH, TEMPLATES, template_named
from sensors.rig.rig_calibration import RigCalibration
from synth.cameras.sensor import Sensor
from synth.cameras.thermal_camera import ThermalNoise
from synth.rig.difficulty import Difficulty

LEPTON_NETD, BOSON_NETD = 0.05 / 0.08, 0.04 / 0.08
"""Noise of a Lepton and a Boson (data sheets: below 50 and 40 mK) over that of an Optris PI200 (80 mK)."""
LEPTON_DRIFT, BOSON_DRIFT = 3.0, 2.0
"""Common error over that of an Optris (2 K of accuracy; Lepton's 5 K by its data sheet). Chosen by eye."""
BOLOMETER_S = 0.012
"""Time constant of a Lepton's pixels (8 to 12 ms); of a Boson's as well. No source for the latter."""
LEPTON_LATE_S, BOSON_LATE_S = 1 / 60, 1 / 120
"""Most time to the nearest of 30 depth images a second (Lepton), or of 60 thermal images (Boson)."""
LEPTON_FLAG_S, BOSON_FLAG_S = 0.9, 0.5
"""Duration of the flat-field correction: 23 frames at 26 Hz (Lepton's data sheet); chosen by eye (Boson)."""
FLAT_FIELD_EVERY_S = (60.0, 180.0)
"""Between two corrections: three minutes, or 1.5 K (Lepton's data sheet); the lower end chosen by eye."""


@dataclass(frozen=True)
class Twin:
    """A virtual rig's cameras. sensor, thermal: faults of depth and of temperature, by difficulty.

    supersample: rendered pixels per pixel side of the thermal camera.
    """

    calibration: RigCalibration
    sensor: Callable[[Difficulty], Sensor]
    thermal: Callable[[ThermalNoise], ThermalNoise]
    supersample: int


def _azure_kinect(faults: Difficulty) -> Sensor:
    """Also a Femto Bolt: a third of the noise, still edges, mixed pixels left out; 0.5 to 3.86 m."""
    one = faults.depth
    return replace(
        one,
        axial=one.axial / 3,
        lateral_px=one.lateral_px / 2,
        rejected=0.95,
        range_mm=(500, 3860),
        camera=AZURE_DEPTH.undistorted(),
        model="azure-kinect-narrow",
    )


def _d455(faults: Difficulty) -> Sensor:
    return replace(faults.stereo, baseline_m=0.095, camera=D455_DEPTH, model="realsense-d455")


def _lepton(noise: ThermalNoise) -> ThermalNoise:
    return _lagging(noise, LEPTON_NETD, LEPTON_DRIFT, LEPTON_FLAG_S, LEPTON_LATE_S)


def _boson(noise: ThermalNoise) -> ThermalNoise:
    return _lagging(noise, BOSON_NETD, BOSON_DRIFT, BOSON_FLAG_S, BOSON_LATE_S)


def _lagging(noise: ThermalNoise, netd: float, drift: float, flag_s: float, late_s: float) -> ThermalNoise:
    """Faults of a camera by those of an Optris; without noise there is no lag either."""
    faulty = noise.netd_c > 0
    return replace(
        noise,
        netd_c=netd * noise.netd_c,
        drift_c=drift * noise.drift_c,
        flag_closed_s=flag_s,
        flag_every_s=FLAT_FIELD_EVERY_S,
        lag_s=BOLOMETER_S * faulty,
        late_s=late_s * faulty,
    )


_CAMERAS: dict[str, tuple[Callable[[Difficulty], Sensor], Callable[[ThermalNoise], ThermalNoise], int]] = {
    "kinect2-optris": (lambda faults: faults.depth, lambda noise: noise, 3),
    "d455-lepton": (_d455, _lepton, 3),
    "bolt-lepton": (_azure_kinect, _lepton, 3),
    "azure-boson": (_azure_kinect, _boson, 2),
}
TWINS = {name: Twin(TEMPLATES[name].calibration, *cameras) for name, cameras in _CAMERAS.items()}
"""The twin of every rig that has a template."""


def twin_named(name: str) -> Twin:
    """The twin of that rig. Raises DeviceError."""
    return TWINS[template_named(name).name]
