"""Parts are apart in colour for all eyes; images survive PNG, and broken ones are refused."""

import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from annotate.crop import SIZE, Crop
from annotate.labelset.images import (
    Probabilities,
    decode_confidence,
    decode_depth,
    decode_parts,
    decode_probabilities,
    encode_confidence,
    encode_parts,
    encode_png,
    encode_probabilities,
)
from annotate.parts import (
    BACKGROUND,
    BODY_PARTS,
    LEFT_RIGHT,
    N_CLASSES,
    NEIGHBOURS,
    PART_ID,
    PARTS,
    palette_rgb,
    swap_left_right,
)
from sensors.errors import FormatError
from tests.helpers.label_maps import depths, law, part_maps

# Parts


def test_parts_are_numbered_named_and_coloured_apart():
    assert [part.id for part in PARTS] == list(range(N_CLASSES))
    assert len({part.name for part in PARTS}) == len({part.rgb for part in PARTS}) == N_CLASSES
    assert PART_ID["background"] == BACKGROUND
    assert len(BODY_PARTS) == 11


def test_the_body_is_a_tree_symmetric_in_left_and_right():
    assert len(NEIGHBOURS) == len(BODY_PARTS) - 1
    reached, frontier = {1}, [1]
    while frontier:
        part = frontier.pop()
        new = {other for pair in NEIGHBOURS if part in pair for other in pair} - reached
        reached |= new
        frontier += new
    assert reached == {part.id for part in BODY_PARTS}
    swap = swap_left_right(np.arange(256, dtype=np.uint8))
    assert {frozenset(int(swap[p]) for p in pair) for pair in NEIGHBOURS} == NEIGHBOURS


@given(parts=part_maps)
@law
def test_left_right_exchange_is_its_own_inverse(parts):
    swapped = swap_left_right(parts)
    np.testing.assert_array_equal(swap_left_right(swapped), parts)
    for left, right in LEFT_RIGHT:
        assert PARTS[left].name == PARTS[right].name.replace("right", "left")
        np.testing.assert_array_equal(swapped == left, parts == right)


# Images


@given(depth=depths, parts=part_maps, confidence=arrays(np.uint8, (6, 8)))
@law
def test_images_survive_png_to_the_bit(depth, parts, confidence):
    np.testing.assert_array_equal(decode_depth(encode_png(depth)), depth)
    np.testing.assert_array_equal(decode_parts(encode_parts(parts)), parts)
    values = confidence.astype(np.float32) / np.float32(255)
    np.testing.assert_array_equal(decode_confidence(encode_confidence(values)), values)


def test_any_viewer_shows_the_parts_colours(tmp_path):
    parts = np.arange(N_CLASSES, dtype=np.uint8).reshape(2, 6)
    (tmp_path / "parts.png").write_bytes(encode_parts(parts))
    with Image.open(tmp_path / "parts.png") as image:
        np.testing.assert_array_equal(np.asarray(image.convert("RGB")), palette_rgb()[parts])


@pytest.mark.parametrize("decode", [decode_depth, decode_parts, decode_confidence])
@given(data=st.data())
@law
def test_a_corrupt_image_is_an_image_or_a_format_error(decode, data):
    encoded = bytearray(encode_png(np.arange(48, dtype=np.uint16).reshape(6, 8)))
    if decode is not decode_depth:
        encoded = bytearray(encode_parts(np.zeros((6, 8), np.uint8)))
    for _ in range(data.draw(st.integers(1, 3))):
        encoded[data.draw(st.integers(0, len(encoded) - 1))] = data.draw(st.integers(0, 255))
    try:
        image = decode(bytes(encoded[: data.draw(st.integers(0, len(encoded)))]))
    except FormatError:
        return
    assert image.ndim == 2


def chunk(kind: bytes, content: bytes) -> bytes:
    return len(content).to_bytes(4, "big") + kind + content + zlib.crc32(kind + content).to_bytes(4, "big")


DEPTH_PNG, PARTS_PNG = encode_png(np.zeros((6, 6), np.uint16)), encode_parts(np.zeros((6, 6), np.uint8))
HUGE = (1 << 30).to_bytes(4, "big")


def twice(data: bytes, side: int) -> bytes:
    """A PNG with a second header."""
    return data[:33] + chunk(b"IHDR", 2 * side.to_bytes(4, "big") + data[24:29]) + data[33:]


@pytest.mark.parametrize(
    ("decode", "data", "says"),
    [
        (decode_depth, DEPTH_PNG[:16] + HUGE + DEPTH_PNG[20:], "1073741824x6"),
        (decode_parts, PARTS_PNG[:16] + HUGE + PARTS_PNG[20:], "1073741824x6"),
        *((decode_depth, twice(DEPTH_PNG, side), "PNG") for side in (20_000, 12_000)),
        *((decode_parts, twice(PARTS_PNG, side), "PNG") for side in (20_000, 12_000)),
        (decode_parts, PARTS_PNG[:-12] + chunk(b"iCCP", b"") + PARTS_PNG[-12:], "cannot be decoded"),
    ],
)
def test_a_hostile_png_is_refused(decode, data, says):
    with pytest.raises(FormatError, match=says):
        decode(data)


BLIND = {
    "none": np.eye(3),
    "protan": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deutan": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritan": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
"""Linear sRGB as seen without one kind of receptors (Machado, Oliveira & Fernandes 2009, severity 1)."""
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


@pytest.mark.parametrize("eyes", BLIND)
def test_neighbours_and_twins_are_apart_in_colour_for_all_eyes(eyes):
    """At least 15 in CIE 1976 L*a*b* (IEC 61966-2-1 for sRGB)."""
    rgb = np.array([part.rgb for part in PARTS]) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ np.transpose(BLIND[eyes]), 0, 1) @ XYZ.T / XYZ.sum(axis=1)
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    lab = np.stack([116 * f[:, 1], 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)
    for one, two in (*NEIGHBOURS, *LEFT_RIGHT):
        assert np.linalg.norm(lab[one] - lab[two]) >= 15, (PARTS[one].name, PARTS[two].name)


def test_an_image_read_twice_is_two_images():
    """A change of one leaves the other and the cache as they are."""
    data = encode_png(np.full((4, 5), 1500, np.uint16))
    one, two = decode_depth(data), decode_depth(data)
    one[:] = 7
    assert (two == 1500).all() and (decode_depth(data) == 1500).all()


UNIFORM = np.full((N_CLASSES, SIZE, SIZE), 1 / N_CLASSES, np.float32)


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_probabilities_round_trip_to_half_a_step(seed):
    planes = np.random.default_rng(seed).dirichlet(np.full(N_CLASSES, 0.2), (SIZE, SIZE)).astype(np.float32)
    given_ = Probabilities(Crop(-3, 5, 300), np.ascontiguousarray(planes.transpose(2, 0, 1)))
    back = decode_probabilities(encode_probabilities(given_), given_.note(), N_CLASSES)
    assert back.crop == given_.crop
    np.testing.assert_allclose(back.planes, given_.planes, atol=0.03)


@pytest.mark.parametrize("crop", [None, [1, 2], [0, 0, 0], [0, 0, 1.5], [0, 0, 10**9], "abc", [True, 0, 9]])
def test_a_malformed_crop_is_named(crop):
    data = encode_probabilities(Probabilities(Crop(0, 0, SIZE), UNIFORM))
    with pytest.raises(FormatError, match="probability_crop"):
        decode_probabilities(data, {"probability_crop": crop}, N_CLASSES)
