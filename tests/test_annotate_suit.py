"""Palettes survive being written, colours survive shade, and what cannot be told apart is refused."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.parts import BODY_PARTS, PARTS
from annotate.suit import DEFAULT_SUIT, MIN_CHROMA_DISTANCE, Suit, chromaticity, load_suit, suit_to_toml
from sensors.errors import CloudError

law = settings(deadline=None, max_examples=60)

colors = st.tuples(*[st.integers(30, 255)] * 3)


@st.composite
def suits(draw) -> Suit:
    """The default suit in another order of hues, some parts with a second, darker swatch."""
    order = draw(st.permutations(range(1, 12)))
    own = [DEFAULT_SUIT.colors_rgb[DEFAULT_SUIT.parts == p][0] for p in order]
    swatches = [(part.id, own[part.id - 1]) for part in BODY_PARTS]
    for part in draw(st.sets(st.sampled_from(BODY_PARTS))):
        swatches.append((part.id, own[part.id - 1] // 2 + 20))
    name = draw(st.text("abcXYZ012 _.-", max_size=20))
    try:
        return Suit(
            name, np.array([c for _, c in swatches], np.uint8), np.array([p for p, _ in swatches], np.uint8)
        )
    except CloudError:
        return DEFAULT_SUIT


@law
@given(suits())
def test_a_palette_survives_being_written(suit):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "suit.toml"
        path.write_text(suit_to_toml(suit), encoding="utf-8")
        back = load_suit(path)
    assert back.name == suit.name
    for part in BODY_PARTS:
        np.testing.assert_array_equal(
            back.colors_rgb[back.parts == part.id], suit.colors_rgb[suit.parts == part.id]
        )
    assert suit_to_toml(back) == suit_to_toml(suit)


@pytest.mark.parametrize("name", ['x"\nevil = 1\n#', "[colors]", "a\\b", "\u202e<b>"])
def test_a_name_cannot_smuggle_toml(tmp_path, name):
    path = tmp_path / "suit.toml"
    path.write_text(suit_to_toml(Suit(name, DEFAULT_SUIT.colors_rgb, DEFAULT_SUIT.parts)), encoding="utf-8")
    np.testing.assert_array_equal(load_suit(path).colors_rgb[2:], DEFAULT_SUIT.colors_rgb[2:])


@law
@given(colors, st.floats(0.1, 1))
def test_shade_does_not_change_chromaticity(rgb, shade):
    """Light that is a share as strong: linear intensities scale, which sRGB raises to 1 / 2.2."""
    color = np.array(rgb, np.float64)
    shaded = color * shade ** (1 / 2.2)
    np.testing.assert_allclose(chromaticity(shaded), chromaticity(color), atol=2e-3)


@law
@given(colors)
def test_chromaticity_is_a_share(rgb):
    x, y = chromaticity(np.array(rgb))
    assert 0 <= x <= 1
    assert 0 <= y <= 1
    assert x + y <= 1


def test_chromaticity_in_closed_form():
    np.testing.assert_allclose(chromaticity(np.array([[255, 0, 0], [0, 255, 0], [9, 9, 9]])),
                               [[1, 0], [0, 1], [1 / 3, 1 / 3]], atol=2e-3)  # fmt: skip
    assert chromaticity(np.zeros((2, 3, 3), np.uint8)).shape == (2, 3, 2)
    assert np.isfinite(chromaticity(np.zeros(3, np.uint8))).all()


def test_the_default_suit_keeps_its_parts_apart():
    chroma = chromaticity(DEFAULT_SUIT.colors_rgb)
    for i, part in enumerate(DEFAULT_SUIT.parts):
        for j, other in enumerate(DEFAULT_SUIT.parts):
            if part != other:
                assert np.linalg.norm(chroma[i] - chroma[j]) >= MIN_CHROMA_DISTANCE


@pytest.mark.parametrize("part", BODY_PARTS, ids=lambda p: p.name)
def test_every_part_needs_a_colour_of_its_own(part):
    keep = DEFAULT_SUIT.parts != part.id
    with pytest.raises(CloudError, match=f"no colour for {part.name}"):
        Suit("s", DEFAULT_SUIT.colors_rgb[keep], DEFAULT_SUIT.parts[keep])
    twin = BODY_PARTS[part.id % 11]
    rgb = DEFAULT_SUIT.colors_rgb.copy()
    rgb[DEFAULT_SUIT.parts == part.id] = rgb[DEFAULT_SUIT.parts == twin.id][0] // 3 * 2
    with pytest.raises(CloudError, match="same colour but for brightness") as refused:
        Suit("s", rgb, DEFAULT_SUIT.parts)
    assert PARTS[part.id].name in str(refused.value)
    assert PARTS[twin.id].name in str(refused.value)
