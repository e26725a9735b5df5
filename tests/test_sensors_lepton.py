"""FLIR Lepton: telemetry word by word, both gains, the shutter; any UVC camera of 16-bit words."""

from contextlib import closing

import numpy as np
import pytest

from sensors.device.protocol import Flag, ThermalCounts, ThermalImage
from sensors.drivers.lepton import RATE_HZ, SIZES, Lepton, Telemetry, telemetry_of
from sensors.drivers.y16 import Radiometry, WordCamera, boson_mode, y16_mode
from sensors.errors import DeviceError, DeviceFaultError
from sensors.recording import open_device as open_device_module
from sensors.recording.open_device import find_devices, open_device
from sensors.rig.pairing import COLOR_WINDOW_NS, THERMAL_WINDOW_NS, pair_stamps, thermal_window_ns
from sensors.virtual.frame_loop import FrameLoop
from sensors.virtual.schedule import Faults
from sensors.virtual.v4l2 import COUNTS, LeptonState, VirtualLepton, VirtualWords, VirtualY16
from tests.helpers.swinging_ball import swinging_ball

SCENE = FrameLoop(swinging_ball())
FAST = Faults(hurry=50.0)
"""The host's clock runs slowly; the device's own clock is a real one's."""


@pytest.fixture
def made():
    """Twins of the test, unplugged at its end."""
    twins = []
    yield twins
    for twin in twins:
        twin.unplug()


@pytest.fixture
def lepton(made):
    """Open the driver on a twin in a state."""

    def opened(**state):
        made.append(VirtualLepton(SCENE, FAST, LeptonState(**state)))
        return made[-1], Lepton(made[-1].node)

    return opened


def read(device, count=1):
    with closing(device):
        device.start()
        return [device.read(10) for _ in range(count)]


def number_of(reading):
    return round((reading.stamp_ns / 1e6 - (2**32 - 2000)) * RATE_HZ / 1000)


def datasheet(uptime_ms=0, status=0, gain=0, effective=0, words=(1, 1)):
    """Telemetry as the datasheet's table 2 lists it: rows A, B, C of 80 words, and a reserved one."""
    rows = np.zeros(4 * 80, np.uint16)
    rows[[1, 2, 3, 4]] = uptime_ms & 0xFFFF, uptime_ms >> 16, status & 0xFFFF, status >> 16
    rows[[160 + 5, 160 + 6, 160 + 48, 160 + 49]] = gain, effective, *words
    return rows


def test_telemetry_is_where_the_datasheet_says():
    assert telemetry_of(datasheet(0x12345678)) == Telemetry(
        0x12345678, Flag.INITIALIZING, "high", False, 0.01
    )
    flags = [telemetry_of(datasheet(status=state << 4)).flag for state in range(4)]
    assert flags == [Flag.INITIALIZING, Flag.OPEN, Flag.CLOSED, Flag.OPEN]
    # Other bits of the status: FFC desired, shutter lockout, too hot.
    others = 1 << 3 | 1 << 15 | 1 << 20
    assert telemetry_of(datasheet(status=others | 2 << 4)) == telemetry_of(datasheet(status=2 << 4))
    assert telemetry_of(datasheet(status=1 << 12)).agc
    assert [telemetry_of(datasheet(words=words)).kelvin for words in ((1, 0), (0, 1))] == [0.1, None]
    gains = [telemetry_of(datasheet(gain=g, effective=e)).gain for g, e in ((0, 1), (1, 0), (2, 0), (2, 1))]
    assert gains == ["high", "low", "high", "low"]
    # A Lepton 2.5 has three rows, not four.
    assert telemetry_of(datasheet(77, 3 << 4)[:240]) == telemetry_of(datasheet(77, 3 << 4))


@pytest.mark.parametrize("gain", ["high", "low", "auto"])
@pytest.mark.parametrize("kelvin", [0.01, 0.1])
@pytest.mark.parametrize("shape", SIZES.values())
def test_temperatures_in_both_gains_and_resolutions(lepton, gain, kelvin, shape):
    twin, device = lepton(gain=gain, kelvin=kelvin, shape=shape)
    (reading,) = read(device)
    assert device.telemetry.gain == ("high" if gain == "high" else "low")
    assert isinstance(reading.value, ThermalImage) and reading.value.flag is Flag.OPEN
    assert reading.value.celsius.dtype == np.float32
    wanted = twin.celsius(number_of(reading))
    assert reading.value.celsius.shape == shape == wanted.shape
    np.testing.assert_allclose(reading.value.celsius, wanted, atol=0.51 * kelvin)


def test_stamps_are_the_cameras_own_across_its_wrap_gaps_are_counted_and_the_shutter_is_named(lepton):
    twin, device = lepton(ffc_every_s=5.0)
    readings = read(device, 60)
    steps = np.diff([r.stamp_ns for r in readings]) * 1e-9 * RATE_HZ
    # The clock counts whole milliseconds; images lost by a slow host are counted.
    np.testing.assert_allclose(steps, [1 + r.dropped for r in readings[1:]], atol=0.02)
    assert readings[-1].stamp_ns > 2**32 * 1_000_000
    states = [twin.ffc_state(number_of(reading)) for reading in readings]
    assert [r.value.flag is Flag.CLOSED for r in readings] == [state == 2 for state in states]
    assert 2 in states and {twin.ffc_state(number) for number in range(45)} == {1, 2, 3}


def test_words_that_are_not_temperatures_are_counts_or_refused(lepton):
    value = read(lepton(kelvin=None)[1])[0].value
    assert isinstance(value, ThermalCounts) and 7000 < np.median(value.counts) < 9000
    with pytest.raises(DeviceFaultError, match="automatic gain control on; switch it off"):
        read(lepton(agc=True)[1])


def test_a_camera_without_telemetry_is_not_a_lepton(made):
    made.append(VirtualY16(SCENE))
    with pytest.raises(DeviceError, match=r"160x120 pixels, not 160x122 or 80x63; update"):
        Lepton(made[0].node)


# --- any camera of 16-bit words ------------------------------------------------------------------


@pytest.fixture
def value_of(made):
    """Value read with one radiometry from words written with another."""

    def read_one(written, radiometry):
        made.append(VirtualY16(SCENE, FAST, VirtualWords(written)))
        return read(WordCamera(made[-1].node, y16_mode(made[-1].size, RATE_HZ, radiometry)))[0].value

    return read_one


@pytest.mark.parametrize("radiometry", [Radiometry(0.01), Radiometry(0.04, -100.0)])
def test_scale_and_offset_make_temperatures(value_of, radiometry):
    value = value_of(radiometry, radiometry)
    assert isinstance(value, ThermalImage) and value.flag is Flag.OPEN
    assert np.quantile(value.celsius, 0.01) == pytest.approx(22, abs=0.5)
    assert value.celsius.max() == pytest.approx(33, abs=0.5)
    assert isinstance(value_of(COUNTS, None), ThermalCounts)


@pytest.mark.parametrize(
    ("made_with", "read_with", "remedy"),
    [
        (Radiometry(0.04, -300.0), Radiometry(0.01), "switch its temperature output on"),
        (Radiometry(0.01), Radiometry(0.1), r"hundredths of a kelvin \(scale=0\.01&offset=-273\.15\)"),
        (Radiometry(0.1), Radiometry(0.01), r"tenths of a kelvin \(scale=0\.1&"),
        (Radiometry(0.02), Radiometry(0.01), r"fiftieths of a kelvin.* \(scale=0\.02&"),
        (Radiometry(1 / 64), Radiometry(0.01), r"64ths of a kelvin.* \(scale=0\.015625&"),
    ],
)
def test_words_of_another_scale_are_refused_with_the_scale_that_fits(value_of, made_with, read_with, remedy):
    with pytest.raises(DeviceFaultError, match=f"which would be .* C; .*{remedy}"):
        value_of(made_with, read_with)


def test_a_boson_in_low_gain_is_refused_with_its_scale(made):
    """FLIR: kelvin times 100 in high gain, times 50 in low gain."""
    made.append(VirtualY16(SCENE, words=VirtualWords(Radiometry(0.02), 60.0, (256, 320))))
    with pytest.raises(DeviceFaultError, match="a Boson's in low gain"):
        read(WordCamera(made[0].node, boson_mode(True)))


@pytest.mark.parametrize(("celsius", "kind"), [("yes", ThermalImage), ("no", ThermalCounts)])
def test_a_boson_gives_counts_or_if_it_is_radiometric_temperatures(celsius, kind):
    value = read(open_device(f"virtual:boson?celsius={celsius}", swinging_ball()))[0].value
    assert isinstance(value, kind)
    image = value.celsius if celsius == "yes" else value.counts
    assert image.shape == (512, 640)
    assert celsius == "no" or image.max() == pytest.approx(33, abs=0.5)


def test_an_address_opens_the_same_camera_again():
    """As it stands in a rig file."""
    with closing(open_device("virtual:y16?scale=0.02&offset=-100&rate=30", swinging_ball())) as device:
        address = device.device.address
    assert address.partition("?")[2] == "width=160&height=120&rate=30&scale=0.02&offset=-100.0"


def test_a_lepton_is_found_by_its_board(monkeypatch):
    found = {"1e4e:0100": [(open_device_module.Path("/dev/video7"), "77")]}
    monkeypatch.setattr(open_device_module, "video_nodes", lambda usb_id: found.get(usb_id, []))
    assert [(f.address, f.serial) for f in find_devices() if f.kind == "lepton" and not f.virtual] == [
        ("lepton:/dev/video7", "77")
    ]


def test_nine_a_second_pair_with_the_nearest_depth_each():
    depth_ns = np.arange(90) * 33_333_333
    for rate_hz, window_ns in ((128, THERMAL_WINDOW_NS), (60, 8_333_333), (9, COLOR_WINDOW_NS)):
        thermal_ns = np.rint(2e6 + np.arange(3 * rate_hz) * 1e9 / rate_hz).astype(np.int64)
        assert abs(thermal_window_ns(thermal_ns) - window_ns) < 2
        pairs = pair_stamps(depth_ns, thermal_ns, thermal_window_ns(thermal_ns))
        assert (pairs >= 0).sum() == min(90, len(thermal_ns))
    assert thermal_window_ns(depth_ns[:1]) == THERMAL_WINDOW_NS
