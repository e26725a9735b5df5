"""Pyrometers: the vectors of the vendor's documents, a hostile line, the driver on a pseudo-terminal."""

import time
from contextlib import closing
from math import isnan

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sensors.drivers import pyrometer, serial_line
from sensors.drivers.pyrometer import Pyrometer, PyrometerOptions
from sensors.drivers.pyrometer_protocol import (
    BURST_ITEMS,
    CS,
    CT,
    HUNDREDTHS,
    SYNC,
    TENTHS,
    BurstParser,
    Scale,
    checksum,
    emissivity_command,
)
from sensors.drivers.serial_line import ChatterError, SerialLine
from sensors.errors import DeviceBusyError, DeviceError, DeviceFaultError, DeviceLostError
from sensors.virtual.pyrometer import BOX_C, HEAD_C, LineFaults, VirtualPyrometer


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    """Local lines answer at once."""
    monkeypatch.setattr(serial_line, "REPLY_S", 0.05)
    monkeypatch.setattr(serial_line, "QUIET_S", 0.005)
    monkeypatch.setattr(pyrometer, "POLL_HZ", 200.0)


@pytest.mark.parametrize(
    ("scale", "reply", "celsius"),
    [(TENTHS, "04D3", 23.5), (HUNDREDTHS, "303E", 23.50), (TENTHS, "04AA", 19.4), (TENTHS, "03E8", 0.0)],
)
def test_temperatures_of_the_vendors_examples(scale, reply, celsius):
    assert scale.decode(bytes.fromhex(reply)) == pytest.approx(celsius)
    assert scale.encode(celsius) == bytes.fromhex(reply)


def test_set_commands_of_the_vendors_examples():
    assert emissivity_command(CS, 0.95) == bytes.fromhex("8403B6")
    assert emissivity_command(CT, 0.95) == bytes.fromhex("8403B631")
    assert checksum(bytes.fromhex("8403B6")) == 0x31
    assert bytes.fromhex("5112300000") == BURST_ITEMS


def test_codes_that_mean_different_things_are_kept_apart():
    assert (CT.box, CT.current_target) == (0x03, 0x81)
    assert (CS.box, CS.current_target) == (None, 0x03)
    codes = {value for value in vars(CS).values() if isinstance(value, int) and not isinstance(value, bool)}
    assert 0x81 not in codes, "on a CS this would drive its analogue output"


@given(st.floats(-50, 555), st.sampled_from([TENTHS, HUNDREDTHS]))
def test_a_temperature_survives_the_line(celsius, scale):
    assert scale.decode(scale.encode(celsius)) == pytest.approx(celsius, abs=0.51 / scale.steps_per_c)


def frames_of(values, scale=TENTHS):
    return [SYNC + b"".join(scale.encode(celsius) for celsius in frame) for frame in values]


ROW = st.lists(st.integers(-500, 9750).map(lambda tenths: tenths / 10), min_size=2, max_size=2)


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=40), st.lists(ROW, min_size=3, max_size=8), st.integers(1, 9))
@example(b"\x04\xaa", [[19.4, 19.4]] * 4, 1)
@example(b"\xaa", [[19.4, 19.4]] * 4, 3)
@example(b"\xaa\xaa\x04", [[19.4, 19.4]] * 4, 5)
def test_burst_is_in_step_again_within_two_frames(noise, values, bite):
    parser, stream = BurstParser(2), noise + b"".join(frames_of(values)) + SYNC + b"\x04"
    seen = [v for at in range(0, len(stream), bite) for v in parser.feed(stream[at : at + bite])]
    expected = [pytest.approx(tuple(row)) for row in values[2:]]
    assert seen[len(seen) - len(expected) :] == expected


@settings(max_examples=200, deadline=None)
@given(st.lists(ROW, min_size=6, max_size=9), st.integers(0, 23), st.binary(max_size=7), st.integers(0, 9))
def test_burst_after_lost_and_foreign_bytes_in_its_middle(values, at, noise, lost):
    stream = b"".join(frames_of(values))
    damaged = stream[:at] + noise + stream[at + lost :] + SYNC + b"\x04"
    untouched = len(values) - -(-(at + lost) // 6)
    expected = [pytest.approx(tuple(row)) for row in values[len(values) - untouched + 2 :]]
    seen = list(BurstParser(2).feed(damaged))
    assert seen[len(seen) - len(expected) :] == expected


@pytest.mark.parametrize(("low", "scale", "celsius"), [("04", TENTHS, 19.4), ("30", HUNDREDTHS, 24.58)])
def test_the_sync_trap_of_a_low_byte_aa(low, scale, celsius):
    """04 AA before AA AA reads AA AA AA: the last pair is the sync, wherever one starts to listen.

    At high resolution AA 30 would be 335.68 C: only that a later pair does as well tells 24.58 C.
    """
    stream = bytes.fromhex(f"AAAA{low}AA") * 6
    for start in range(4):
        seen = list(BurstParser(1, scale).feed(stream[start:]))
        assert len(seen) >= 4 and all(value == pytest.approx(celsius) for (value,) in seen)


def test_one_sync_alone_makes_no_frame():
    noise = SYNC + bytes.fromhex("04D304D3") + b"\x00"
    frames = frames_of([[20.0, 21.0], [22.0, 23.0]])
    seen = list(BurstParser(2).feed(noise + b"".join(frames) + SYNC + b"\x04"))
    assert seen == [pytest.approx((20.0, 21.0)), pytest.approx((22.0, 23.0))]


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=300), st.integers(1, 8), st.sampled_from([TENTHS, HUNDREDTHS]))
def test_random_bytes_give_possible_values_or_none(data, count, scale):
    parser = BurstParser(count, scale)
    values = [value for frame in parser.feed(data) for value in frame]
    assert all(-50 <= value <= 975 for value in values)
    assert parser.skipped + 2 * len(values) + 2 * (len(values) // count) <= len(data)


def opened(pyro, **options):
    return Pyrometer(pyro.port, PyrometerOptions(**options))


@pytest.fixture
def twin():
    made = []

    def make(faults=None, target_c=lambda seconds: 31.2, **options):
        made.append(VirtualPyrometer(PyrometerOptions(**options), faults, target_c))
        return made[-1]

    yield make
    for pyro in made:
        pyro.unplug()


@pytest.mark.parametrize("family", [CT, CS])
@pytest.mark.parametrize("scale", [TENTHS, HUNDREDTHS])
def test_poll_reads_what_the_twin_sees(twin, family, scale):
    pyro = twin(family=family, scale=scale)
    with closing(opened(pyro, family=family, scale=scale)) as device:
        device.start()
        spot = device.read(1.0).value
    assert spot.target_c == pytest.approx(31.2) and spot.head_c == pytest.approx(HEAD_C)
    assert (spot.box_c == pytest.approx(BOX_C)) if family is CT else isnan(spot.box_c)


@pytest.mark.parametrize("family", [CT, CS])
def test_emissivity_is_set_and_read_back(twin, family):
    pyro = twin(target_c=lambda seconds: 40.0, family=family)
    with closing(opened(pyro, family=family)) as device:
        device.set_emissivity(0.95)
        assert device.emissivity() == pyro.emissivity == 0.95
        assert device.serial == "8031234"
        device.start()
        assert device.read(1).value.target_c == pytest.approx(22 + 18 * 0.97 / 0.95, abs=0.06)


def test_a_set_that_did_not_arrive_is_noticed(twin):
    pyro = twin(faults=LineFaults(refuse=1.0))
    with closing(Pyrometer(pyro.port)) as device:
        with pytest.raises(DeviceFaultError, match=r"has emissivity 0\.97 although 0\.95 was set; try again"):
            device.set_emissivity(0.95)
        assert device.emissivity() == 0.97


def test_a_wrong_checksum_changes_nothing(twin):
    pyro = twin()
    line = SerialLine(pyro.port, 115200, None)
    with closing(line), pytest.raises(DeviceFaultError, match="answered 0 of 2 bytes"):
        line.request(bytes.fromhex("8403B632"), 2)
    assert pyro.emissivity == 0.97


def test_rs485_address_selects_the_device(twin):
    pyro = twin(rs485=7)
    with closing(opened(pyro, rs485=7)) as device:
        device.set_emissivity(0.5)
    assert pyro.emissivity == 0.5
    with pytest.raises(DeviceFaultError, match="answered 0 of 3"):
        opened(pyro, rs485=8)
    opened(pyro, rs485=7).close()


@pytest.mark.parametrize(("there", "asked"), [(CT, CS), (CS, CT)])
def test_the_wrong_family_is_named(twin, there, asked):
    pyro = twin(target_c=lambda seconds: 40.0, family=there)
    with pytest.raises(DeviceError, match=f"like the {there.name} family, not {asked.name}; give family"):
        opened(pyro, family=asked)
    opened(pyro, family=there).close()


def test_burst_on_a_line_that_loses_bytes(twin):
    pyro = twin(target_c=lambda seconds: 19.4)
    with closing(opened(pyro, burst=True)) as device:
        device.start()
        pyro.faults = LineFaults(loss=0.03, noise=0.02)
        readings = [device.read(1) for _ in range(60)]
    good = [r.value for r in readings if r.value.target_c == pytest.approx(19.4)]
    assert len(good) > 45 and sum(r.dropped for r in readings) > 3
    with pytest.raises(DeviceError, match="cs family has no burst"):
        PyrometerOptions(CS, burst=True)


@settings(max_examples=8, deadline=None)
@given(st.floats(0, 0.6), st.floats(0, 0.6), st.integers(0, 99))
def test_a_noisy_line_never_hangs_and_recovers(noise, loss, seed):
    pyro = VirtualPyrometer(seed=seed, target_c=lambda seconds: 25.0)
    try:
        with closing(Pyrometer(pyro.port)) as device:
            device.start()
            pyro.faults = LineFaults(noise=noise, loss=loss)
            for _ in range(3):
                try:
                    device.read(0.1)
                except DeviceLostError:
                    break
                except DeviceFaultError as fault:
                    assert "\n" not in str(fault)
            pyro.faults = LineFaults()
            assert device.read(1).value.target_c == pytest.approx(25.0)
    finally:
        pyro.unplug()


@settings(max_examples=15, deadline=None)
@given(st.binary(max_size=60))
def test_random_replies_raise_only_sensor_errors(data):
    """The other end talks nonsense; every call comes back, with a value or one of the sensors' errors."""
    pyro = VirtualPyrometer()
    try:
        with closing(Pyrometer(pyro.port)) as device:
            pyro._answer = lambda command: data
            device.start()
            for call in (lambda: device.read(0.02), device.emissivity):
                try:
                    call()
                except DeviceFaultError as fault:
                    assert "\n" not in str(fault)
                except DeviceLostError:
                    return
    finally:
        pyro.unplug()


def test_a_late_reply_is_not_taken_for_the_next_ones(twin):
    pyro = twin()
    with closing(Pyrometer(pyro.port)) as device:
        device.start()
        pyro.faults = LineFaults(delay_s=0.07)
        with pytest.raises(DeviceFaultError, match="answered 0 of 2"):
            device.read(1)
        pyro.faults = LineFaults()
        time.sleep(0.1)
        spot = device.read(1).value
    assert (spot.target_c, spot.head_c) == (pytest.approx(31.2), pytest.approx(HEAD_C))


def test_a_dead_line_is_reported_as_lost(twin):
    pyro = twin()
    with closing(Pyrometer(pyro.port)) as device:
        device.start()
        pyro.faults = LineFaults(loss=1.0)
        for _ in range(pyrometer.SILENT_READS - 1):
            with pytest.raises(DeviceFaultError):
                device.read(1)
        with pytest.raises(DeviceLostError, match="does not answer; check power"):
            device.read(1)


def test_a_burst_that_nobody_ended_is_ended(twin, monkeypatch):
    """A recording that was killed leaves the device sending."""
    monkeypatch.setattr(serial_line, "QUIET_S", 0.05)
    pyro = twin()
    killed = opened(pyro, burst=True)
    killed.start()
    killed._line.close()
    with (
        closing(SerialLine(pyro.port, 115200, None)) as line,
        pytest.raises(ChatterError, match="does not stop"),
    ):
        line.request(b"\x01", 2)
    with closing(Pyrometer(pyro.port)) as device:
        device.start()
        assert device.serial == "8031234" and device.read(1).value.target_c == pytest.approx(31.2)


def test_a_port_that_is_none(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(DeviceError, match=r"cannot be opened .*; give a device node"):
        Pyrometer(tmp_path / "file")


def test_a_port_in_use_and_an_impossible_baud_rate(twin):
    pyro = twin()
    with closing(Pyrometer(pyro.port)), pytest.raises(DeviceBusyError, match="in use by another program"):
        Pyrometer(pyro.port)
    with pytest.raises(DeviceError, match="baud rate -1 is impossible"):
        opened(pyro, baud=-1)


def test_scale_refuses_what_no_head_measures():
    with pytest.raises(DeviceFaultError, match="outside -50 to 975 C; check cable"):
        Scale(1000, 10).decode(b"\xff\xff")
