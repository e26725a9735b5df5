"""Radiometric JPEGs of FLIR's and DJI's cameras, packed as ExifTool documents them, become temperatures."""

from itertools import product

import cv2
import numpy as np
import pytest

from sensors.errors import FormatError
from sensors.files.flir_jpeg import has_flir, read_flir
from sensors.importers.flir_images import FlirImages
from sensors.importers.open_source import open_source
from tests.helpers.flir_files import PLANCK, Written, flir_jpeg, raw_of

CELSIUS = np.linspace(15, 40, 120 * 160, dtype=np.float32).reshape(120, 160)
PHOTO = np.full((60, 80, 3), (200, 120, 40), np.uint8)
PHOTO[:30] = (40, 90, 150)


def pixels(encoded: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


@pytest.fixture
def one(tmp_path):
    (tmp_path / "take.jpg").write_bytes(flir_jpeg(CELSIUS, PHOTO))
    return tmp_path / "take.jpg"


WAYS = list(product("<>", "<>", ["words", "png", "png-straight"]))


@pytest.mark.parametrize(("order", "record", "raw"), WAYS)
@pytest.mark.parametrize("shape", [(120, 160), (480, 640)])
def test_temperatures_come_back_in_every_byte_order(order, record, raw, shape):
    """By Planck's law, to a word of the camera; over several segments of the file too."""
    celsius = np.linspace(-10, 60, shape[0] * shape[1]).reshape(shape)
    image = read_flir(flir_jpeg(celsius, how=Written(order, record, raw)), "x.jpg")
    assert image.celsius.dtype == np.float32 and image.photo is None
    np.testing.assert_allclose(image.celsius, celsius, atol=0.05)


def seen_through(celsius, scene):
    """Words of a scene behind air, a window and air, by adding up radiation from the scene to the camera."""
    emissivity, distance_m, reflected_c, air_c, window_c, window, humidity = scene
    water = humidity * np.exp(1.5587 + 6.939e-2 * air_c - 2.7816e-4 * air_c**2 + 6.8455e-7 * air_c**3)
    way = np.sqrt(distance_m / 2)
    first, second = (
        np.exp(-way * (0.006569 - 0.002276 * water**0.5)),
        np.exp(-way * (0.01262 - 0.00667 * water**0.5)),
    )
    air = 1.9 * first - 0.9 * second
    r1, r2, b, f, o = PLANCK.values()

    def radiates(temperature):
        return r1 / (r2 * (np.exp(b / (temperature + 273.15)) - f)) - o

    at_scene = emissivity * radiates(celsius) + (1 - emissivity) * radiates(reflected_c)
    at_window = air * at_scene + (1 - air) * radiates(air_c)
    behind = window * at_window + (1 - window) * radiates(window_c)
    return air * behind + (1 - air) * radiates(air_c)


@pytest.mark.parametrize("seed", range(6))
def test_what_is_between_scene_and_camera_is_taken_away(seed):
    rng = np.random.default_rng(seed)
    emissivity, distance, window, humidity = rng.uniform([0.3, 0.5, 0.6, 0.1], [1, 40, 1, 0.9])
    reflected, air, pane = rng.uniform(-5, 45, 3)
    celsius = np.linspace(5, 70, 60 * 80).reshape(60, 80)
    words = seen_through(celsius, (emissivity, distance, reflected, air, pane, window, humidity))
    r1, r2, b, f, o = PLANCK.values()
    black = b / np.log(r1 / (r2 * (words + o)) + f) - 273.15  # what gives these words without all that
    scene = [emissivity, distance, reflected + 273.15, air + 273.15, pane + 273.15, window]
    fields = {32 + 4 * n: float(number) for n, number in enumerate(scene)} | {60: float(humidity)}
    found = read_flir(flir_jpeg(black, how=Written(scene=fields)), "x.jpg").celsius
    np.testing.assert_allclose(found, celsius, atol=0.3)
    percent = fields | {60: float(100 * humidity)}
    np.testing.assert_allclose(
        read_flir(flir_jpeg(black, how=Written(scene=percent)), "x.jpg").celsius, found, atol=1e-3
    )


def test_flyr_finds_the_same(tmp_path):
    flyr = pytest.importorskip("flyr", reason="no flyr, which is not needed: pip install flyr")
    scene = {32: 0.95, 36: 3.0, 40: 300.0, 44: 290.0, 60: 0.4}
    (tmp_path / "x.jpg").write_bytes(flir_jpeg(CELSIUS, how=Written(scene=scene)))
    expected = flyr.unpack(str(tmp_path / "x.jpg")).celsius
    np.testing.assert_allclose(open_source(tmp_path / "x.jpg").frame(0).thermal_c, expected, atol=0.01)


def test_a_scene_that_is_not_stated_is_a_black_body_near_by():
    """DJI leaves fields at 0."""
    nothing = dict.fromkeys((32, 36, 40, 44, 48, 52, 60, 112, 116, 120, 124, 128), 0.0)
    found = read_flir(flir_jpeg(CELSIUS, how=Written(order="<", scene=nothing)), "x.jpg").celsius
    np.testing.assert_allclose(found, CELSIUS, atol=0.05)


@pytest.mark.parametrize("kind", ["jpg", "png", "png-rgb"])
@pytest.mark.parametrize("record", "<>")
def test_photographs_have_their_colours(kind, record):
    """FLIR's PNGs are in Y Cb Cr (ExifTool, FLIR EmbeddedImage)."""
    image = read_flir(flir_jpeg(CELSIUS, PHOTO, Written(record=record, photo=kind)), "x.jpg")
    away = np.abs(pixels(image.photo).astype(int) - PHOTO)
    away[26:34] = 0  # JPEG's edge
    assert away.max() <= 4


def test_a_photograph_without_temperatures_is_refused(one, tmp_path):
    assert has_flir(one)
    (tmp_path / "plain.jpg").write_bytes(b"\xff\xd8\xff\xe0 a holiday's")
    assert not has_flir(tmp_path / "plain.jpg")
    with pytest.raises(FormatError, match="without a FLIR camera's temperatures"):
        open_source(tmp_path / "plain.jpg")


def plain_photo() -> bytes:
    return cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()


def test_a_folder_is_read_in_natural_order_without_its_photographs(tmp_path):
    for number, offset in ((10, 4.0), (9, 2.0), (1, 0.0)):
        (tmp_path / f"FLIR{number}.jpg").write_bytes(flir_jpeg(CELSIUS + offset))
    for name in ("DC_0002.jpg", "A.jpeg", "Z.JPG", "AB.jpg"):
        (tmp_path / name).write_bytes(plain_photo())
    (tmp_path / "._FLIR1.jpg").write_bytes(b"\0\5\x16\7")
    source = open_source(tmp_path)
    assert isinstance(source, FlirImages) and len(source) == 3
    assert [round(float(source.frame(at).thermal_c[0, 0])) for at in range(3)] == [15, 17, 19]
    assert "no depth images: temperatures alone cannot be labelled" in source.notes
    assert "4 photographs without temperatures left out: A.jpeg, AB.jpg, DC_0002.jpg, ..." in source.notes


def test_of_two_models_in_a_folder_most_images_count(tmp_path):
    for name, shape in {"a": (60, 80), "b": (120, 160), "c": (120, 160)}.items():
        (tmp_path / f"{name}.jpg").write_bytes(flir_jpeg(np.full(shape, 30.0)))
    source = open_source(tmp_path)
    assert len(source) == 2 and source.calibration.thermal.shape == (120, 160)
    assert "1 images of another size than 160x120 left out: a.jpg" in source.notes


def test_lens_and_times_are_those_of_the_files(tmp_path):
    start = 1_500_000_000
    for number, name in enumerate("ab"):
        scene = {0x1B4: 25.0, 0x384: start + 7 * number, 0x388: 250}
        (tmp_path / f"{name}.jpg").write_bytes(flir_jpeg(CELSIUS, how=Written(scene=scene)))
    source = open_source(tmp_path)
    np.testing.assert_array_equal(
        source.times_ns, [start * 10**9 + 250 * 10**6, (start + 7) * 10**9 + 250 * 10**6]
    )
    assert source.calibration.thermal.fx == pytest.approx(80 / np.tan(np.radians(12.5)))
    assert "a lens 25 degrees wide, as the files state" in source.notes


def test_a_damaged_image_is_refused_in_one_line():
    whole = flir_jpeg(CELSIUS, PHOTO)
    for broken in (whole[:3000], whole[:200] + bytes(9000), flir_jpeg(CELSIUS, how=Written(scene={88: 0.0}))):
        with pytest.raises(FormatError, match="holds no temperatures"):
            read_flir(broken, "x.jpg")
    rng, refused = np.random.default_rng(0), 0
    for _ in range(300):
        spoilt = bytearray(whole)
        for _ in range(3):
            spoilt[rng.integers(2, 1200)] = rng.integers(0, 256)
        try:
            read_flir(bytes(spoilt), "x.jpg")
        except FormatError as error:
            assert "\n" not in str(error)
            refused += 1
    assert refused > 20


def test_words_that_no_temperature_gives_are_no_reading():
    celsius = np.full((8, 8), 20.0)
    content = flir_jpeg(celsius)
    words = raw_of(celsius).astype("<u2").tobytes()
    found = read_flir(content.replace(words, b"\0\0" * 32 + words[64:]), "x.jpg").celsius
    assert np.isnan(found[:4]).all() and np.isfinite(found[4:]).all()
