"""Variants of the virtual rig: other depth or thermal cameras, with faults as strong as a ``Difficulty``."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from sensors.recording.rig_templates import CAMERAS, TEMPLATES, template_named
from sensors.rig.rig_calibration import RigCalibration
from synth.cameras.maker_filters import Filtered
from synth.cameras.sensor import Sensor
from synth.cameras.stereo import Stereo
from synth.cameras.thermal_camera import ThermalNoise
from synth.cameras.time_of_flight import TimeOfFlight
from synth.own_camera import OwnCamera
from synth.rig.difficulty import CLEAN, Difficulty

BOLOMETER_S = 0.012  # time constant of a Lepton's pixels (8 to 12 ms); of a Boson's untuned
FLAT_FIELD_EVERY_S = (60.0, 180.0)  # three minutes or 1.5 K (Lepton's data sheet); lower end untuned


class _Thermal(NamedTuple):
    """Thermal camera relative to an Optris PI200: factors on noise and drift; seconds of a closed
    flag (shutter), and of delay.
    """

    netd: float
    drift: float
    flag_s: float
    late_s: float


# Data sheets: noise below 50 and 40 mK (Optris 80); 23 frames at 26 Hz of a Lepton's flag; greatest delay to
# one of 30 depth or 60 thermal images a second. Drifts and a Boson's flag are untuned.
_LEPTON = _Thermal(0.05 / 0.08, 3.0, 0.9, 1 / 60)
_BOSON = _Thermal(0.04 / 0.08, 2.0, 0.5, 1 / 120)


@dataclass(frozen=True)
class Variant:
    """Cameras of a virtual rig.

    sensor: function from a difficulty to the depth camera with its faults. thermal: function from a PI200's
    noise to this thermal camera's. supersample: rendered pixels per pixel side of the thermal camera.
    """

    calibration: RigCalibration
    sensor: Callable[[Difficulty], Sensor]
    thermal: Callable[[ThermalNoise], ThermalNoise]
    supersample: int


def _azure_kinect(faults: Difficulty) -> Sensor:
    """Return an Azure Kinect or Femto Bolt: a third of the noise, half the jitter, few mixed pixels; 0.5 to
    3.86 m.
    """
    one = faults.depth
    return replace(
        one,
        axial=one.axial / 3,
        lateral_px=one.lateral_px / 2,
        rejected=0.95,
        range_mm=(500, 3860),
        camera=CAMERAS["azure_depth"].undistorted(),
        model="azure-kinect-narrow",
    )


def _d455(faults: Difficulty) -> Sensor:
    return replace(faults.stereo, baseline_m=0.095, camera=CAMERAS["d455_depth"], model="realsense-d455")


def _bolometer(camera: _Thermal, noise: ThermalNoise) -> ThermalNoise:
    """Return a thermal camera's faults from an Optris PI200's. Without noise, lag and delay are 0 too."""
    faulty = noise.netd_c > 0
    return replace(
        noise,
        netd_c=camera.netd * noise.netd_c,
        drift_c=camera.drift * noise.drift_c,
        flag_closed_s=camera.flag_s,
        flag_every_s=FLAT_FIELD_EVERY_S,
        lag_s=BOLOMETER_S * faulty,
        late_s=camera.late_s * faulty,
    )


_CAMERAS: dict[str, tuple[Callable[[Difficulty], Sensor], Callable[[ThermalNoise], ThermalNoise], int]] = {
    "kinect2-optris": (lambda faults: faults.depth, lambda noise: noise, 3),
    "d455-lepton": (_d455, partial(_bolometer, _LEPTON), 3),
    "bolt-lepton": (_azure_kinect, partial(_bolometer, _LEPTON), 3),
    "azure-boson": (_azure_kinect, partial(_bolometer, _BOSON), 2),
}
VARIANTS = {name: Variant(TEMPLATES[name].calibration, *cameras) for name, cameras in _CAMERAS.items()}


def with_camera(variant: Variant, own: OwnCamera, rng: np.random.Generator) -> Variant:
    """Return a variant with a user's depth camera in the place of its own.

    A camera of no stated sensor has the faults of the variant's. Faults of a stated sensor are drawn, strong
    to none, whatever the difficulty; at ``CLEAN`` there are none.
    """
    pinhole, drawn = own.pinhole.undistorted(), own(rng)

    def sensor(faults: Difficulty) -> Sensor:
        if own.sensor is not None:
            return Filtered(0.0, camera=pinhole) if faults is CLEAN else drawn
        usual = variant.sensor(faults)
        assert isinstance(usual, TimeOfFlight | Stereo)  # the templates have no other cameras
        return replace(usual, camera=pinhole)

    return replace(variant, calibration=replace(variant.calibration, depth=own.pinhole), sensor=sensor)


def variant_named(name: str) -> Variant:
    """Return the variant of a rig template. Raises DeviceError for an unknown name."""
    return VARIANTS[template_named(name).name]
