"""A mirrored JPEG shows the sensor's pixels from right to left, whatever its size and EXIF say."""

import io

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from sensors.files.jpeg import is_lossless, mirrored_jpeg
from sensors.importers.declared import turned_color
from sensors.rig.frame import RigFrame
from sensors.rig.turn import Turn

SAMPLINGS = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]


def decoded(encoded):
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    return cv2.imdecode(np.frombuffer(encoded, np.uint8), flags).astype(int)


def photograph(width, height, seed, sampling=SAMPLINGS[0]):
    noise = np.random.default_rng(seed).integers(0, 256, (height, width, 3)).astype(np.uint8)
    smooth = cv2.GaussianBlur(noise, (0, 0), 4)
    options = [cv2.IMWRITE_JPEG_QUALITY, 90, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
    return cv2.imencode(".jpg", smooth, options)[1].tobytes()


@given(st.integers(17, 90), st.integers(17, 90), st.integers(0, 99), st.sampled_from(SAMPLINGS))
def test_of_any_size_it_is_the_image_from_right_to_left(width, height, seed, sampling):
    image = photograph(width, height, seed, sampling)
    np.testing.assert_allclose(decoded(mirrored_jpeg(image)), decoded(image)[:, ::-1], atol=20)


@pytest.mark.skipif(not is_lossless(), reason="libturbojpeg is not installed: apt install libturbojpeg0")
@given(st.integers(1, 6), st.integers(17, 90), st.integers(0, 99))
def test_of_whole_blocks_nothing_is_lost(blocks, height, seed):
    image = photograph(16 * blocks, height, seed)
    twice = mirrored_jpeg(mirrored_jpeg(image))
    np.testing.assert_array_equal(decoded(twice), decoded(image))


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize("mirror", [False, True])
def test_an_imported_colour_image_is_turned_and_mirroring_twice_loses_nothing(quarters, mirror):
    image, turn = photograph(48, 64, quarters), Turn(quarters, mirror)
    turned = turned_color(image, turn)
    np.testing.assert_allclose(decoded(turned), turn.image(decoded(image)), atol=20)
    if quarters == 0 and is_lossless():
        np.testing.assert_array_equal(decoded(turned_color(turned, turn)), decoded(image))


@pytest.mark.parametrize("orientation", range(1, 9))
def test_an_exif_orientation_turns_nothing(orientation):
    half, file = np.zeros((32, 64, 3), np.uint8), io.BytesIO()
    half[:, :32] = 255
    exif = Image.Exif()
    exif[0x112] = orientation
    Image.fromarray(half).save(file, "JPEG", exif=exif)
    found = decoded(mirrored_jpeg(file.getvalue()))
    assert found.shape == (32, 64, 3) and found[:, 34:].min() > 240 and found[:, :30].max() < 15


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff", b"no image", photograph(64, 64, 0)[:300]])
def test_bytes_of_no_image_stay_as_they_are(data):
    assert mirrored_jpeg(data) == data


@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_camera_s_colour_image_is_decoded_as_the_sensor_has_it(orientation, kind):
    quarter, file = np.zeros((32, 64, 3), np.uint8), io.BytesIO()
    quarter[:16, :32] = (250, 10, 10)
    exif = Image.Exif()
    exif[0x112] = orientation
    Image.fromarray(quarter).save(file, kind, exif=exif)
    found = RigFrame(0, 0, np.zeros((4, 4), np.uint16), file.getvalue()).decode_color()
    assert found.shape == quarter.shape and np.abs(found.astype(int) - quarter).mean() < 3
