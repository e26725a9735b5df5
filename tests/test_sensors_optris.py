"""Optris: layouts word by word, the flag, gaps and short buffers, the vendor's library through its ABI."""

import ctypes
import shutil
import subprocess
from contextlib import closing

import cv2
import numpy as np
import pytest

from sensors.device.protocol import Flag, ThermalCounts, ThermalImage
from sensors.device.v4l2_camera import V4l2Node
from sensors.drivers.flag_watch import FlagWatch
from sensors.drivers.optris import LAYOUTS, Optris, pack, unpack
from sensors.drivers.optris_direct import (
    PROTOTYPES,
    DirectLibrary,
    FrameMetadata,
    OptrisDirect,
    celsius_of,
    check_config,
    flag_of,
)
from sensors.errors import (
    DeviceBusyError,
    DeviceError,
    DeviceFaultError,
    DeviceLostError,
    DeviceNotFoundError,
)
from sensors.virtual.frame_loop import FrameLoop
from sensors.virtual.optris_direct import VirtualDirect
from sensors.virtual.schedule import Faults
from sensors.virtual.v4l2 import VirtualOptris
from tests.helpers.swinging_ball import swinging_ball

NAMES = tuple(LAYOUTS)
SCENE = FrameLoop(swinging_ball())


def facts_layout(name, frame):
    """Images and metadata by the table of facts, word by word."""
    stream, images, metadata = frame.ravel().tolist(), [], []
    width = {"128hz": 164, "96hz-bispectral": 764, "128hz-bispectral": 760}[name]
    rows, skip, data = {
        "128hz": (120, 0, 160),
        "96hz-bispectral": (160, 640, 120),
        "128hz-bispectral": (120, 596, 160),
    }[name]
    for start in range(0, len(stream), rows * width):
        words = []
        for row in range(rows):
            at = start + row * width + skip
            words += stream[at : at + data]
        images.append(np.array(words).reshape(120, 160))
        metadata.append([stream[start + row * width + width - 1] for row in [92, 94, *range(96, 117, 2)]])
    return images, metadata


@pytest.mark.parametrize("name", NAMES)
def test_every_word_is_where_the_facts_say(name):
    layout = LAYOUTS[name]
    assert layout.thermal_hz == {"128hz": 128, "96hz-bispectral": 96, "128hz-bispectral": 128}[name]
    assert layout.width - layout.visible - layout.data == 4
    frame = np.random.default_rng(3).integers(0, 65536, (layout.height, layout.width), np.uint16)
    images, metadata = facts_layout(name, frame)
    found = unpack(layout, frame)
    assert len(found) == len(images) == layout.subframes
    for (counts, words), image, expected in zip(found, images, metadata, strict=True):
        np.testing.assert_array_equal(counts, image)
        assert words.tolist() == expected and len(expected) == 13
    # ``pack`` writes the same words back.
    for (counts, words), (same, too) in zip(found, unpack(layout, pack(layout, found)), strict=True):
        np.testing.assert_array_equal(counts, same)
        np.testing.assert_array_equal(words, too)


def opened(name="128hz", faults=None, **options):
    layout = LAYOUTS[name]
    camera = VirtualOptris(layout, SCENE, faults, **options)
    return camera, Optris(camera.node, layout)


@pytest.mark.parametrize("name", NAMES)
def test_the_driver_reads_what_the_camera_saw(name):
    camera, device = opened(name)
    with closing(device):
        device.start()
        readings = [device.read(1) for _ in range(9)]
    camera.unplug()
    numbers = [int(r.value.metadata[0]) for r in readings]
    assert np.diff(numbers).tolist() == [1 + r.dropped for r in readings[1:]]
    for number, reading in zip(numbers, readings, strict=True):
        assert isinstance(reading.value, ThermalCounts) and reading.value.flag is Flag.OPEN
        np.testing.assert_array_equal(reading.value.counts, camera.counts(number))
    steps_s = np.diff([r.stamp_ns for r in readings]) * 1e-9
    np.testing.assert_allclose(steps_s, np.diff(numbers) / LAYOUTS[name].thermal_hz, atol=1e-6)


@pytest.mark.parametrize("name", ["128hz", "96hz-bispectral"])
def test_gaps_and_short_buffers_are_counted_to_the_image(name):
    """Whatever was lost on the way: received and dropped together are what the camera made."""
    layout, (camera, opened_device) = LAYOUTS[name], opened(name, Faults(drop=0.1, short=0.1))
    numbers, dropped, faults = [], 0, 0
    with closing(opened_device) as device:
        device.start()
        while len(numbers) < 60:
            try:
                reading = device.read(1)
            except DeviceFaultError as fault:
                assert (
                    f"of {2 * layout.width * layout.height} bytes; if this happens again, use a USB port"
                    in str(fault)
                )
                faults += 1
                continue
            dropped += reading.dropped if numbers else 0
            numbers.append(int(reading.value.metadata[0]))
    camera.unplug()
    assert faults and dropped and numbers[-1] - numbers[0] + 1 == len(numbers) + dropped


def test_a_closed_flag_is_recognised():
    camera, device = opened(flag_every_s=0.9)
    with closing(device):
        device.start()
        readings = [device.read(1) for _ in range(160)]
    camera.unplug()
    for reading in readings:
        seconds = int(reading.value.metadata[0]) / 128
        assert reading.value.flag is (Flag.CLOSED if seconds % 0.9 >= 0.4 else Flag.OPEN)


def test_a_scene_that_stays_flat_is_no_flag_and_a_frozen_image_is_one():
    rng = np.random.default_rng(0)
    lively, flat = rng.normal(8000, 200, (120, 160)), rng.normal(8000, 2, (120, 160))

    def image(base):
        return np.rint(base + rng.normal(0, 2, base.shape)).astype(np.uint16)

    watch = FlagWatch(10.0)
    assert [watch.flag(image(lively)) for _ in range(5)] == [Flag.OPEN] * 5
    after = [watch.flag(image(flat)) for _ in range(30)]
    assert after == [Flag.CLOSED] * 15 + [Flag.OPEN] * 15
    assert [watch.flag(image(lively)) for _ in range(5)] == [Flag.OPEN] * 5
    frozen = image(lively)
    assert [watch.flag(frozen) for _ in range(4)] == [Flag.OPEN] + [Flag.CLOSED] * 3


def test_a_camera_in_another_mode_is_named():
    camera = VirtualOptris(LAYOUTS["128hz"], SCENE)
    with pytest.raises(DeviceError, match=r"sends images of 164x120 pixels, not 760x480; choose its mode"):
        Optris(camera.node, LAYOUTS["128hz-bispectral"])
    camera.unplug()
    with pytest.raises(DeviceNotFoundError, match="does not exist; plug the device in"):
        Optris(camera.node, LAYOUTS["128hz"])


def test_a_late_frame_is_left_out():
    camera, device = opened()
    stamps_s = [1.0, 1.0 + 1 / 128, 1.0, 1.0 + 4 / 128]
    camera.schedule.device_s = lambda number: stamps_s.pop(0)
    with closing(device):
        assert [device.read(1).dropped for _ in range(3)] == [0, 0, 2]
    camera.unplug()


def test_opencv_itself_has_what_the_seam_asks_for(tmp_path):
    """The fake kernel stands in for these very names; a node of another file does not stream."""
    capture = cv2.VideoCapture()
    for name in ("isOpened", "set", "get", "retrieve", "release"):
        assert callable(getattr(capture, name))
    assert "timeoutNs" in cv2.VideoCapture.waitAny.__doc__
    node = tmp_path / "video0"
    node.touch()
    with pytest.raises(DeviceBusyError, match="does not stream"):
        Optris(V4l2Node(node), LAYOUTS["128hz"])


# --- the vendor's library --------------------------------------------------------------------------


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "generic.xml"
    path.write_text("<imager><serial>0</serial></imager>")
    return path


def test_temperatures_and_flag_of_the_vendors_library(config):
    twin = VirtualDirect(SCENE, flag_every_s=0.7)
    with closing(OptrisDirect(config, twin.library)) as device:
        device.set_emissivity(0.97)
        assert twin.emissivity == pytest.approx(0.97) and device.serial == "13110042"
        device.start()
        readings = [device.read(1) for _ in range(90)]
    flags = [r.value.flag for r in readings]
    assert {Flag.OPEN, Flag.CLOSING, Flag.CLOSED, Flag.OPENING} == set(flags)
    first = readings[0].value
    assert isinstance(first, ThermalImage) and first.celsius.dtype == np.float32
    assert np.abs(first.celsius - SCENE.thermal(0)).max() < 0.6
    closed = [r.value.celsius for r in readings if r.value.flag is Flag.CLOSED]
    assert all(np.array_equal(closed[0], image) for image in closed)


def test_the_librarys_output_is_tenths_above_1000():
    np.testing.assert_allclose(celsius_of(np.uint16([[1000, 1235, 0]])), [[0, 23.5, -100]])
    assert flag_of(5) is Flag.INITIALIZING and flag_of(17) is Flag.ERROR


def test_temperatures_with_more_decimal_places_are_refused_before_the_camera_opens(config):
    """libirimager's own comment in generic.xml: 1 enables more than one decimal place, by the camera."""
    text = "<imager><serial>0</serial>{}</imager>"
    for harmless in (
        "<enable_high_precision>0</enable_high_precision>",
        "<!-- <enable_high_precision>1</enable_high_precision> -->",
    ):
        config.write_text(text.format(harmless))
        OptrisDirect(config, VirtualDirect(SCENE).library).close()
    config.write_text(text.format("<enable_high_precision> 1 </enable_high_precision>"))
    with pytest.raises(DeviceError, match="enable_high_precision 1, which has another unit; set it to 0"):
        OptrisDirect(config, VirtualDirect(SCENE).library)


def test_an_image_that_is_no_temperatures_is_a_fault_and_reading_goes_on(config, monkeypatch):
    twin = VirtualDirect(SCENE)
    whole = twin._values
    monkeypatch.setattr(twin, "_values", lambda n: whole(n) if n else np.full((120, 160), 12_000, np.uint16))
    with closing(OptrisDirect(config, twin.library)) as device:
        device.start()
        with pytest.raises(DeviceFaultError, match="values with a median of 12000, which would be 1100 C"):
            device.read(1)
        assert np.abs(device.read(1).value.celsius - SCENE.thermal(0)).max() < 0.6


def test_a_calibration_file_that_is_missing_is_named(tmp_path, config):
    check_config(config)
    config.write_text(f"<imager><serial> 42 </serial><calipath>{tmp_path}</calipath></imager>")
    with pytest.raises(DeviceNotFoundError, match=r"Cali-42\.xml is missing; run: sudo ir_download"):
        OptrisDirect(config, VirtualDirect(SCENE).library)
    (tmp_path / "Cali-42.xml").touch()
    OptrisDirect(config, VirtualDirect(SCENE).library).close()
    with pytest.raises(DeviceNotFoundError, match=r"cannot be read .*; make it with ir_generate"):
        check_config(tmp_path / "absent.xml")


def test_the_library_that_opens_nothing_or_falls_silent(config, monkeypatch):
    monkeypatch.setattr(OptrisDirect, "silence_s", 0.1)
    twin = VirtualDirect(SCENE)
    with closing(OptrisDirect(config, twin.library)) as device:
        with pytest.raises(DeviceBusyError, match="serves one camera"):
            OptrisDirect(config, twin.library)
        device.start()
        assert device.read(1) is not None
        twin.unplug()
        with pytest.raises(DeviceLostError, match=r"sent nothing for 0\.1 s; check its cable"):
            while True:
                device.read(0.5)
    other = VirtualDirect(SCENE)
    other.library.usb_init(b"", None, None)
    with pytest.raises(DeviceError, match=r"cannot open a camera with .*; plug it in"):
        OptrisDirect(config, other.library)


STUB = """
// A library with the vendor's ABI, compiled: it fills every field of what it is given.
#include <string.h>
enum EvoIRFlagState { irFlagOpen, irFlagClose, irFlagOpening, irFlagClosing, irFlagError, irFlagInit };
struct EvoIRFrameMetadata {
  unsigned int counter; unsigned int counterHW; long long timestamp; long long timestampMedia;
  enum EvoIRFlagState flagState; float tempChip; float tempFlag; float tempBox;
};
static unsigned int n;
int evo_irimager_usb_init(const char *xml, const char *formats, const char *log) {
  n = 0; return xml && strlen(xml) && !formats && !log ? 0 : -1; }
int evo_irimager_get_serial(unsigned long *serial) { *serial = 4242; return 0; }
int evo_irimager_get_thermal_image_size(int *w, int *h) { *w = 8; *h = 6; return 0; }
int evo_irimager_get_thermal_image_metadata(
    int *w, int *h, unsigned short *data, struct EvoIRFrameMetadata *metadata) {
  struct EvoIRFrameMetadata now = {n, 3 * n, 1000LL + 78125LL * n, 7, irFlagInit, 1.5f, 2.5f, 3.5f};
  for (int i = 0; i < *w * *h; ++i) data[i] = 1000 + i;
  *metadata = now; ++n; return *w == 8 && *h == 6 ? 0 : -1; }
int evo_irimager_set_radiation_parameters(float e, float t, float a) {
  return e == 0.5f && t == 1.0f && a == -999.0f ? 0 : -1; }
int evo_irimager_terminate(void) { return 0; }
"""


def test_the_driver_speaks_the_abi_of_a_compiled_library(config, tmp_path):
    if shutil.which("gcc") is None:
        pytest.skip("no gcc to compile the library")
    (tmp_path / "stub.c").write_text(STUB)
    out = tmp_path / "libirdirectsdk.so"
    subprocess.run(
        ["gcc", "-shared", "-fPIC", "-Werror", str(tmp_path / "stub.c"), "-o", str(out)], check=True
    )
    binary = ctypes.CDLL(str(out))
    library = DirectLibrary(**{k: make((f"evo_irimager_{k}", binary)) for k, make in PROTOTYPES.items()})
    with closing(OptrisDirect(config, library)) as device:
        assert (device.serial, device.shape) == ("4242", (6, 8))
        device.set_emissivity(0.5)
        with pytest.raises(DeviceError, match=r"refused emissivity 0\.6; give"):
            device.set_emissivity(0.6)
        device.start()
        first, second = device.read(1), device.read(1)
    assert first.value.flag is Flag.INITIALIZING
    np.testing.assert_allclose(first.value.celsius, np.arange(48).reshape(6, 8) / 10, rtol=1e-6)
    assert (first.stamp_ns, second.stamp_ns, second.dropped) == (100_000, 7_912_500, 2)
    assert ctypes.sizeof(FrameMetadata) == 40


def test_without_the_vendors_library_one_line_says_so(monkeypatch, config):
    monkeypatch.setattr("sensors.drivers.optris_direct.find_library", lambda name: None)
    with pytest.raises(DeviceNotFoundError, match=r"libirdirectsdk\.so is not installed; install"):
        OptrisDirect(config)
