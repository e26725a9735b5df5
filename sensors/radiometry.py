"""From radiance in the thermal camera's band to temperature: emissivity without a fixed exponent.

The band is 7.5 to 13 um (Optris PI, and 8 to 14 um pyrometers nearly). The vendor's U = C (eps T^n ..) needs
another n at every temperature (4.9 at 23 C, 4.0 at 100 C); here Planck's law is integrated instead.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sensors.errors import DeviceError
from sensors.rig.camera import FloatArray

BAND_UM = (7.5, 13.0)
KELVIN = 273.15
_C1L = 1.191042972e8
"""First radiation constant for spectral radiance, 2 h c^2, in W um^4 m^-2 sr^-1 (CODATA 2018)."""
_C2 = 1.438776877e4
"""Second radiation constant, h c / k, in um K (CODATA 2018)."""
_NODES = 24
"""Gauss-Legendre nodes: the integrand is smooth, and 24 are exact to rounding."""
_TABLE_C = np.linspace(-60.0, 980.0, 4161)


def band_radiance(celsius: FloatArray | float, band_um: tuple[float, float] = BAND_UM) -> NDArray[np.float64]:
    """Radiance of a black body within a band, W m^-2 sr^-1; Planck's law, integrated numerically."""
    kelvin = np.asarray(celsius, np.float64)[..., None] + KELVIN
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    low, high = band_um
    wavelength = (high - low) / 2 * node + (high + low) / 2
    spectral = _C1L / wavelength**5 / np.expm1(_C2 / (wavelength * kelvin))
    return np.asarray((high - low) / 2 * (spectral * weight).sum(axis=-1), np.float64)


def temperature_of_radiance(radiance: FloatArray | float) -> NDArray[np.float64]:
    """Inverse of ``band_radiance``: Celsius, by table; NaN outside -60 to 980 C. Errors stay below 1 mK."""
    table = _log_radiance()
    with np.errstate(divide="ignore", invalid="ignore"):
        wanted = np.log(np.asarray(radiance, np.float64))
    return np.asarray(np.interp(wanted, table, _TABLE_C, left=np.nan, right=np.nan), np.float64)


def object_temperature(
    apparent_c: FloatArray | float, emissivity: float, ambient_c: float, transmissivity: float = 1.0
) -> NDArray[np.float64]:
    """True temperature of a grey surface that looks as hot as a black body of ``apparent_c``.

    The surface emits ``emissivity`` of the radiance of its temperature and reflects the rest from
    surroundings of ``ambient_c``; a window passes ``transmissivity`` of it and itself is at ambient.
    NaN where what remains is no radiance of a body. Raises DeviceError for an impossible emissivity.
    """
    check_emissivity(emissivity, transmissivity)
    own = band_radiance(ambient_c)
    share = emissivity * transmissivity
    return temperature_of_radiance((band_radiance(apparent_c) - (1 - share) * own) / share)


def apparent_temperature(
    true_c: FloatArray | float, emissivity: float, ambient_c: float, transmissivity: float = 1.0
) -> NDArray[np.float64]:
    """Inverse of ``object_temperature``: how hot the surface looks to a camera set to emissivity 1."""
    check_emissivity(emissivity, transmissivity)
    share = emissivity * transmissivity
    return temperature_of_radiance(share * band_radiance(true_c) + (1 - share) * band_radiance(ambient_c))


def check_emissivity(emissivity: float, transmissivity: float = 1.0) -> None:
    """Raise DeviceError where one of the two is not a share of 0.01 to 1."""
    for name, share in (("emissivity", emissivity), ("transmissivity", transmissivity)):
        if not 0.01 <= share <= 1:
            raise DeviceError(f"{name} {share:g} is impossible; give 0.01 to 1 (skin has 0.98)")


@lru_cache(maxsize=1)
def _log_radiance() -> NDArray[np.float64]:
    return np.log(band_radiance(_TABLE_C))
