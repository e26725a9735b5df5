"""FLIR Lepton: telemetry word by word, both gains, the shutter; any UVC camera of 16-bit words."""

from contextlib import closing

import numpy as np
import pytest

from sensors.device.protocol import Flag, ThermalCounts, ThermalImage
from sensors.drivers.lepton import RATE_HZ, SIZES, Lepton, Telemetry, telemetry_of
from sensors.drivers.y16 import Boson, Radiometry, Y16Camera
from sensors.errors import DeviceError, DeviceFaultError
from sensors.recording import open_device as open_device_module
from sensors.recording.open_device import find_devices, open_device
from sensors.rig.pairing import COLOR_WINDOW_NS, THERMAL_WINDOW_NS, pair_stamps, thermal_window_ns
from sensors.virtual.fake_kernel import FakeKernel
from sensors.virtual.frame_loop import FrameLoop
from sensors.virtual.optris import VirtualOptris
from sensors.virtual.y16 import VirtualLepton, VirtualY16
from tests.helpers.swinging_ball import swinging_ball

SCENE = FrameLoop(swinging_ball())
HURRY = 50.0
"""Times as fast as a real one, by the host's clock; its own clock is a real one's."""


@pytest.fixture
def lepton():
    """Opens the driver on a twin."""
    made = []

    def opened(**options):
        made.append(VirtualLepton(SCENE, hurry=HURRY, **options))
        return made[-1], Lepton(made[-1].node, kind=FakeKernel(made[-1]))

    yield opened
    for twin in made:
        twin.unplug()


def datasheet(uptime_ms=0, status=0, gain=0, effective=0, tlinear=1, resolution=1):
    """Telemetry as the datasheet's table 2 lists it: rows A, B, C of 80 words, and one that is reserved."""
    words = np.zeros(4 * 80, np.uint16)
    words[[1, 2]] = uptime_ms & 0xFFFF, uptime_ms >> 16
    words[[3, 4]] = status & 0xFFFF, status >> 16
    words[160 + 5], words[160 + 6], words[160 + 48], words[160 + 49] = gain, effective, tlinear, resolution
    return words


def test_telemetry_is_where_the_datasheet_says():
    assert telemetry_of(datasheet(0x12345678)) == Telemetry(
        0x12345678, Flag.INITIALIZING, "high", False, 0.01
    )
    flags = [telemetry_of(datasheet(status=state << 4)).flag for state in range(4)]
    assert flags == [Flag.INITIALIZING, Flag.OPEN, Flag.CLOSED, Flag.OPEN]
    # Everything else that the status holds: FFC desired, shutter lockout, too hot.
    others = 1 << 3 | 1 << 15 | 1 << 20
    assert telemetry_of(datasheet(status=others | 2 << 4)) == telemetry_of(datasheet(status=2 << 4))
    assert telemetry_of(datasheet(status=1 << 12)).agc
    assert telemetry_of(datasheet(resolution=0)).kelvin == 0.1
    assert telemetry_of(datasheet(tlinear=0)).kelvin is None
    gains = [telemetry_of(datasheet(gain=g, effective=e)).gain for g, e in ((0, 1), (1, 0), (2, 0), (2, 1))]
    assert gains == ["high", "low", "high", "low"]
    # A Lepton 2.5 has three rows, not four.
    assert telemetry_of(datasheet(77, 3 << 4)[:240]) == telemetry_of(datasheet(77, 3 << 4))


@pytest.mark.parametrize("gain", ["high", "low", "auto"])
@pytest.mark.parametrize("kelvin", [0.01, 0.1])
@pytest.mark.parametrize("shape", SIZES.values())
def test_temperatures_in_both_gains_and_resolutions(lepton, gain, kelvin, shape):
    twin, device = lepton(gain=gain, kelvin=kelvin, shape=shape)
    with closing(device):
        device.start()
        readings = [device.read(10) for _ in range(3)]
    assert device.telemetry.gain == ("high" if gain == "high" else "low")
    for reading in readings:
        assert isinstance(reading.value, ThermalImage) and reading.value.flag is Flag.OPEN
        assert reading.value.celsius.dtype == np.float32
    number = round((readings[0].stamp_ns / 1e6 - (2**32 - 2000)) * RATE_HZ / 1000)
    wanted = twin.celsius(number)
    assert readings[0].value.celsius.shape == shape == wanted.shape
    np.testing.assert_allclose(readings[0].value.celsius, wanted, atol=0.51 * kelvin)


def test_stamps_are_the_cameras_own_across_its_wrap_and_gaps_are_counted(lepton):
    _, device = lepton()
    with closing(device):
        device.start()
        readings = [device.read(10) for _ in range(40)]
    steps = np.diff([r.stamp_ns for r in readings]) * 1e-9 * RATE_HZ
    # The clock counts whole milliseconds; whatever a slow host has lost is counted.
    np.testing.assert_allclose(steps, [1 + r.dropped for r in readings[1:]], atol=0.02)
    assert readings[-1].stamp_ns > 2**32 * 1_000_000


def test_images_of_the_closed_shutter_say_so(lepton):
    twin, device = lepton(ffc_every_s=5.0)
    with closing(device):
        device.start()
        readings = [device.read(10) for _ in range(60)]
    flags = []
    for reading in readings:
        number = round((reading.stamp_ns / 1e6 - (2**32 - 2000)) * RATE_HZ / 1000)
        assert reading.value.flag is (Flag.CLOSED if twin.ffc_state(number) == 2 else Flag.OPEN)
        flags.append(reading.value.flag)
    assert {Flag.OPEN, Flag.CLOSED} == set(flags)
    assert {twin.ffc_state(number) for number in range(45)} == {1, 2, 3}


def test_what_is_no_temperature_is_refused_as_temperature(lepton):
    _, device = lepton(kelvin=None)
    with closing(device):
        device.start()
        value = device.read(10).value
    assert isinstance(value, ThermalCounts) and 7000 < np.median(value.counts) < 9000
    _, device = lepton(agc=True)
    with closing(device):
        device.start()
        with pytest.raises(DeviceFaultError, match="automatic gain control on; switch it off"):
            device.read(10)


def test_a_camera_without_telemetry_is_no_lepton():
    plain = VirtualY16(SCENE)
    with pytest.raises(
        DeviceError, match=r"gives \(160, 120\), not \(160, 122\) or \(80, 63\) words; update"
    ):
        Lepton(plain.node, kind=FakeKernel(plain))
    plain.unplug()


# --- any camera of 16-bit words ------------------------------------------------------------------


def read_one(twin, radiometry):
    with closing(Y16Camera(twin.node, twin.size, RATE_HZ, radiometry, kind=FakeKernel(twin))) as device:
        device.start()
        return device.read(10).value


@pytest.mark.parametrize("radiometry", [Radiometry(0.01), Radiometry(0.04, -100.0)])
def test_scale_and_offset_make_temperatures(radiometry):
    twin = VirtualY16(SCENE, radiometry=radiometry, hurry=HURRY)
    value = read_one(twin, radiometry)
    twin.unplug()
    assert isinstance(value, ThermalImage) and value.flag is Flag.OPEN
    assert np.quantile(value.celsius, 0.01) == pytest.approx(22, abs=0.5)
    assert value.celsius.max() == pytest.approx(33, abs=0.5)


@pytest.mark.parametrize(
    ("made", "read", "remedy"),
    [
        (Radiometry(0.04, -300.0), Radiometry(0.01), "switch its temperature output on"),
        (
            Radiometry(0.01),
            Radiometry(0.1),
            r"they fit hundredths of a kelvin \(scale=0\.01&offset=-273\.15\)",
        ),
        (Radiometry(0.1), Radiometry(0.01), r"they fit tenths of a kelvin \(scale=0\.1&"),
        (Radiometry(0.02), Radiometry(0.01), r"they fit fiftieths of a kelvin.* \(scale=0\.02&"),
        (Radiometry(1 / 64), Radiometry(0.01), r"they fit 64ths of a kelvin.* \(scale=0\.015625&"),
    ],
)
def test_words_that_would_be_no_temperatures_are_refused_with_the_scale_that_fits(made, read, remedy):
    twin = VirtualY16(SCENE, radiometry=made, hurry=HURRY)
    with pytest.raises(DeviceFaultError, match=f"which would be .* C; {remedy}"):
        read_one(twin, read)
    twin.unplug()


def test_a_boson_in_low_gain_is_refused_with_its_scale():
    """FLIR: kelvin times 100 in high gain, times 50 in low gain."""
    twin = VirtualY16(SCENE, radiometry=Radiometry(0.02), rate_hz=60.0, shape=(256, 320))
    with closing(Boson(twin.node, True, kind=FakeKernel(twin))) as device:
        device.start()
        with pytest.raises(DeviceFaultError, match="a Boson's in low gain"):
            device.read(10)
    twin.unplug()


@pytest.mark.parametrize(("celsius", "kind"), [("yes", ThermalImage), ("no", ThermalCounts)])
def test_a_boson_gives_counts_or_where_it_is_radiometric_temperatures(celsius, kind):
    with closing(open_device(f"virtual:boson?celsius={celsius}", swinging_ball())) as device:
        device.start()
        value = device.read(10).value
    assert isinstance(value, kind)
    image = value.celsius if celsius == "yes" else value.counts
    assert image.shape == (512, 640)
    assert celsius == "no" or image.max() == pytest.approx(33, abs=0.5)


def test_without_scale_they_stay_counts():
    twin = VirtualY16(SCENE, hurry=HURRY)
    assert isinstance(read_one(twin, None), ThermalCounts)
    twin.unplug()


@pytest.mark.parametrize(
    ("address", "match"),
    [
        ("y16:/dev/video77?scale=0.01", "gives only one of scale and offset; give both, or none for counts"),
        ("y16:/dev/video77?width=0", "width '0' .* is not a number from 1"),
        (
            "y16:/dev/video77?mode=1",
            "unknown option 'mode'; its options: height, mirror, offset, rate, scale, turn, width",
        ),
        ("y16:", "names no node; give for instance y16:/dev/video0"),
        ("y16:/dev/video77", "/dev/video77 does not exist; plug"),
        ("lepton:/dev/video77", "/dev/video77 does not exist; plug"),
    ],
)
def test_addresses(address, match):
    with pytest.raises(DeviceError, match=match):
        open_device(address)


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


def test_opencvs_own_property_is_the_fourcc():
    """The fake kernel gives bytes to the Optris only, which asks for YUYV."""
    camera = VirtualOptris(open_device_module.LAYOUTS["128hz"], SCENE)
    assert FakeKernel(camera)(str(camera.node), 0).retrieve()[1].dtype == np.uint16
    camera.unplug()


# --- pairing ---------------------------------------------------------------------------------------


def test_nine_a_second_pair_with_the_nearest_depth_each():
    depth_ns = np.arange(90) * 33_333_333
    for rate_hz, window_ns in ((128, THERMAL_WINDOW_NS), (60, 8_333_333), (9, COLOR_WINDOW_NS)):
        thermal_ns = np.rint(2e6 + np.arange(3 * rate_hz) * 1e9 / rate_hz).astype(np.int64)
        assert abs(thermal_window_ns(thermal_ns) - window_ns) < 2
        pairs = pair_stamps(depth_ns, thermal_ns, thermal_window_ns(thermal_ns))
        assert (pairs >= 0).sum() == min(90, len(thermal_ns))
    assert thermal_window_ns(depth_ns[:1]) == THERMAL_WINDOW_NS
