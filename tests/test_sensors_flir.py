"""FLIR's radiometric JPEGs, read by the real flyr from files built as ExifTool documents them."""

import numpy as np
import pytest

from sensors.errors import FormatError
from sensors.files.flir_jpeg import is_flir, read_flir
from sensors.importers.flir_images import FlirImages
from sensors.importers.open_source import open_source
from sensors.session.reader import Session
from tests.helpers.flir_files import flir_jpeg

CELSIUS = np.linspace(15, 40, 120 * 160, dtype=np.float32).reshape(120, 160)
PHOTO = np.full((60, 80, 3), (200, 120, 40), np.uint8)


@pytest.fixture
def flyr():
    return pytest.importorskip("flyr", reason="no flyr: pip install 'annotate-cloud[flir]'")


@pytest.fixture
def one(tmp_path):
    (tmp_path / "take.jpg").write_bytes(flir_jpeg(CELSIUS, PHOTO))
    return tmp_path / "take.jpg"


@pytest.mark.parametrize("shape", [(120, 160), (480, 640)])
def test_temperatures_come_back_by_plancks_law(flyr, shape):
    """To a word of the camera, over several segments of the file too."""
    celsius = np.linspace(-10, 60, shape[0] * shape[1]).reshape(shape)
    image = read_flir(flir_jpeg(celsius), "x.jpg")
    assert image.celsius.dtype == np.float32 and image.photo is None
    np.testing.assert_allclose(image.celsius, celsius, atol=0.05)


def test_an_image_becomes_a_session_by_one_command(flyr, one, tmp_path, annotate_cloud):
    done = annotate_cloud("import", one, tmp_path / "take.mcap")
    assert done.code == 0, done.err
    (frame,) = Session(tmp_path / "take.mcap")
    np.testing.assert_allclose(frame.thermal_c, CELSIUS, atol=0.05)
    assert not frame.depth_mm.any()
    np.testing.assert_allclose(frame.decode_color()[30, 40], PHOTO[0, 0], atol=4)
    assert annotate_cloud("info", tmp_path / "take.mcap").code == 0


def test_a_folder_is_read_in_the_order_of_its_names(flyr, tmp_path):
    for name, offset in (("b", 2.0), ("a", 0.0)):
        (tmp_path / f"{name}.jpg").write_bytes(flir_jpeg(CELSIUS + offset))
    source = open_source(tmp_path)
    assert isinstance(source, FlirImages) and len(source) == 2
    assert [round(float(f.thermal_c[0, 0])) for f in source] == [15, 17]
    assert "no depth images: temperatures alone cannot be labelled" in source.notes


def test_only_flirs_own_jpegs_are_taken_for_such(one, tmp_path):
    assert is_flir(one)
    plain = tmp_path / "plain.jpg"
    plain.write_bytes(b"\xff\xd8\xff\xe0 a holiday's")
    assert not is_flir(plain)
    with pytest.raises(FormatError, match="of no known kind"):
        open_source(plain)
    (tmp_path / "depth").mkdir()
    with pytest.raises(FormatError, match="holds no depth images"):
        open_source(tmp_path)


def test_a_damaged_image_is_refused_in_one_line(flyr):
    whole = flir_jpeg(CELSIUS)
    for broken in (whole[:3000], whole[:200] + bytes(9000)):
        with pytest.raises(FormatError, match="holds no temperatures"):
            read_flir(broken, "x.jpg")
