"""Band radiance against its series and Stefan-Boltzmann, emissivity there and back, drift of the camera."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sensors.errors import CalibrationError, DeviceError
from sensors.fir_reference import fit_drift
from sensors.radiometry import (
    BAND_UM,
    KELVIN,
    apparent_temperature,
    band_radiance,
    object_temperature,
    temperature_of_radiance,
)

SIGMA = 5.670374419e-8
C2_UM_K = 1.438776877e4
TEMPERATURES = st.floats(-40, 400)


def series(celsius, low_um, high_um):
    """Radiance between two wavelengths by the series of the black body's fractional function."""
    kelvin = celsius + KELVIN

    def below(wavelength):
        x = C2_UM_K / (wavelength * kelvin)
        n = np.arange(1, 400)
        terms = np.exp(-n * x) * (x**3 / n + 3 * x**2 / n**2 + 6 * x / n**3 + 6 / n**4)
        return 15 / np.pi**4 * terms.sum()

    return SIGMA * kelvin**4 / np.pi * (below(high_um) - below(low_um))


@pytest.mark.parametrize("celsius", [-40, 0, 23, 33, 100, 400, 900])
def test_numeric_integration_equals_the_closed_series(celsius):
    assert band_radiance(celsius) == pytest.approx(series(celsius, *BAND_UM), rel=3e-9)


def test_the_whole_spectrum_gives_stefan_and_boltzmann():
    edges = np.geomspace(0.8, 3000, 60)
    total = sum(band_radiance(300 - KELVIN, pair) for pair in pairwise(edges))
    assert total == pytest.approx(SIGMA * 300**4 / np.pi, rel=1e-5)


@pytest.mark.parametrize(("celsius", "exponent"), [(23, 4.9), (100, 4.0)])
def test_the_local_exponent_is_the_published_one(celsius, exponent):
    low, high = band_radiance(celsius - 0.01), band_radiance(celsius + 0.01)
    n = np.log(high / low) / np.log((celsius + 0.01 + KELVIN) / (celsius - 0.01 + KELVIN))
    assert n == pytest.approx(exponent, abs=0.05)


def test_table_is_exact_to_a_millikelvin():
    celsius = np.linspace(-59.9, 979.9, 3001)
    np.testing.assert_allclose(temperature_of_radiance(band_radiance(celsius)), celsius, atol=1e-3)
    assert np.isnan(temperature_of_radiance(np.array([0.0, -1.0, 1e9]))).all()


@given(TEMPERATURES, st.floats(0.3, 1), st.floats(-20, 60), st.floats(0.5, 1))
def test_emissivity_there_and_back(celsius, emissivity, ambient_c, transmissivity):
    seen = apparent_temperature(celsius, emissivity, ambient_c, transmissivity)
    assert min(celsius, ambient_c) - 0.01 <= seen <= max(celsius, ambient_c) + 0.01
    assert object_temperature(seen, emissivity, ambient_c, transmissivity) == pytest.approx(celsius, abs=0.02)


def test_emissivity_of_skin_and_impossible_ones():
    """0.02 less emissivity make 33 C skin in a room of 22 C look about 0.2 K cooler."""
    assert apparent_temperature(33.0, 0.98, 22.0) == pytest.approx(32.79, abs=0.02)
    assert object_temperature(33.0, 1.0, 22.0) == pytest.approx(33.0, abs=1e-3)
    for emissivity in (0.0, 1.01, float("nan")):
        with pytest.raises(DeviceError, match="is impossible; give"):
            object_temperature(30.0, emissivity, 20.0)
    assert np.isnan(object_temperature(-40.0, 0.05, 60.0))


@pytest.mark.parametrize("gain", [0.97, 1.0, 1.04])
def test_drift_is_found_among_wild_pairs(gain):
    rng = np.random.default_rng(7)
    true = rng.uniform(20, 40, 600)
    camera = (true - 1.3) / gain + rng.normal(0, 0.08, 600)
    camera[::4] += rng.uniform(3, 20, 150)
    true[::50] = np.nan
    drift = fit_drift(camera, true)
    assert drift.gain == pytest.approx(gain, abs=0.02) and drift.pairs == 588
    clean = np.arange(600) % 4 != 0
    assert np.nanmedian(np.abs(drift.correct(camera) - true)[clean]) < 0.15


def test_over_a_small_range_drift_is_an_offset_alone():
    rng = np.random.default_rng(1)
    true = rng.normal(33, 0.3, 50)
    drift = fit_drift(true - 0.8 + rng.normal(0, 0.05, 50), true)
    assert drift.gain == 1 and drift.offset_c == pytest.approx(0.8, abs=0.03)
    assert drift.sd_c == pytest.approx(0.05, abs=0.02)
    assert drift.correct(np.float32([[np.nan, 32]])).dtype == np.float32


def test_drift_refuses_too_few_pairs_and_other_scenes():
    with pytest.raises(CalibrationError, match="only 4 pairs"):
        fit_drift(np.array([1, 2, 3, 4, np.nan]), np.ones(5))
    with pytest.raises(CalibrationError, match=r"a factor of 2\.00; point both at one spot"):
        fit_drift(np.arange(30.0), 2 * np.arange(30.0))
