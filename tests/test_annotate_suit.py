"""Palettes survive being written, colours survive shade, and look-alikes are named."""

import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import assert_refused
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from annotate.labelset.label_set import LabelSet
from annotate.parts import BODY_PARTS, PAPER
from annotate.scheme.merging import conversion_table
from annotate.scheme.scheme_file import load_scheme
from annotate.suit.color_model import BARE_COST, GAIN, SIGMA, under, unfitted
from annotate.suit.palette import (
    DEFAULT_SUIT,
    Suit,
    chromaticity,
    load_suit,
    suit_to_toml,
)
from annotate.suit.palette_learning import clouds_with, corrected_frames, suit_from_labels, suit_from_photo
from sensors.errors import CloudError
from sensors.session.reader import Session

SIX, HANDS = load_scheme("six"), load_scheme("hands-and-feet")
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
    return Suit(
        "s", np.array([c for _, c in swatches], np.uint8), np.array([p for p, _ in swatches], np.uint8)
    )


NAMES = st.text(max_size=20) | st.sampled_from(['x"\nevil = 1\n#', "[colors]", "a\\b", "\u202e<b>"])


@law
@given(suits(), NAMES)
def test_a_palette_survives_being_written(suit, name):
    suit = replace(suit, name=name)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "suit.toml"
        path.write_bytes(suit_to_toml(suit).encode())
        back = load_suit(path)
    assert back.name == suit.name and suit_to_toml(back) == suit_to_toml(suit)
    for part in BODY_PARTS:
        np.testing.assert_array_equal(
            back.colors_rgb[back.parts == part.id], suit.colors_rgb[suit.parts == part.id]
        )


@law
@given(colors, st.floats(0.1, 1))
def test_shade_does_not_change_chromaticity(rgb, shade):
    """Light that is a share as strong: linear intensities scale, which sRGB raises to 1 / 2.2."""
    color = np.array(rgb, np.float64)
    shaded = color * shade ** (1 / 2.2)
    np.testing.assert_allclose(chromaticity(shaded), chromaticity(color), atol=2e-3)


def test_chromaticity_in_closed_form():
    np.testing.assert_allclose(chromaticity(np.array([[255, 0, 0], [0, 255, 0], [9, 9, 9]])),
                               [[1, 0], [0, 1], [1 / 3, 1 / 3]], atol=2e-3)  # fmt: skip
    assert chromaticity(np.zeros((2, 3, 3), np.uint8)).shape == (2, 3, 2)
    assert np.isfinite(chromaticity(np.zeros(3, np.uint8))).all()


@pytest.mark.parametrize("part", BODY_PARTS, ids=lambda p: p.name)
def test_every_part_needs_a_colour_and_look_alikes_are_named(part):
    keep = DEFAULT_SUIT.parts != part.id
    with pytest.raises(CloudError, match=f"no colour for {part.name}"):
        Suit("s", DEFAULT_SUIT.colors_rgb[keep], DEFAULT_SUIT.parts[keep])
    twin = BODY_PARTS[part.id % 11]
    rgb = DEFAULT_SUIT.colors_rgb.copy()
    rgb[DEFAULT_SUIT.parts == part.id] = rgb[DEFAULT_SUIT.parts == twin.id][0] // 3 * 2
    suit = Suit("s", rgb, DEFAULT_SUIT.parts)
    assert (min(part.id, twin.id), max(part.id, twin.id)) in suit.look_alikes
    assert part.name in suit.notes[0]
    assert twin.name in suit.notes[0]
    assert "another hue" in suit.notes[0]
    assert not DEFAULT_SUIT.look_alikes


def test_parts_that_share_skin_do_not_look_alike():
    skin = DEFAULT_SUIT.colors_rgb[1]
    colors, parts = np.vstack([DEFAULT_SUIT.colors_rgb, skin, skin]), np.append(DEFAULT_SUIT.parts, [5, 6])
    assert not Suit("s", colors, parts.astype(np.uint8)).look_alikes
    own = np.flatnonzero(parts == 5)[0]
    bare_arm = Suit("s", np.delete(colors, own, axis=0), np.delete(parts, own).astype(np.uint8))
    assert (1, 5) in bare_arm.look_alikes


def nearest(suit: Suit, learnt: Suit) -> dict[str, float]:
    """Return the least chromaticity distance of each part's learnt swatches to its own."""
    own, found = chromaticity(suit.colors_rgb), chromaticity(learnt.colors_rgb)
    return {
        p.name: np.linalg.norm(own[suit.parts == p.id][:, None] - found[learnt.parts == p.id], axis=2).min()
        for p in BODY_PARTS
    }


def test_a_palette_is_learnt_from_right_frames(rig_session):
    truth = LabelSet.open(rig_session.with_suffix(".truth"))
    ids = corrected_frames(truth)
    learnt = suit_from_labels(clouds_with(truth, ids, Session(rig_session)), "learnt")
    assert max(nearest(DEFAULT_SUIT, learnt).values()) < 0.05
    assert not learnt.look_alikes


def test_a_palette_is_learnt_in_the_scheme_of_the_labels(rig_session):
    """Both arms are one part of ``six``, with the colours of both sides."""
    truth = LabelSet.open(rig_session.with_suffix(".truth"))
    table = conversion_table(PAPER, SIX)
    frames = clouds_with(truth, corrected_frames(truth), Session(rig_session))
    in_six = ((cloud, replace(one, parts=table[one.parts], scheme=SIX)) for cloud, one in frames)
    learnt = suit_from_labels(in_six, "learnt", SIX)
    assert learnt.scheme == SIX
    for part in SIX.parts:
        own = [one for one in PAPER.parts if one.regions <= part.regions]
        worn = chromaticity(np.concatenate([DEFAULT_SUIT.swatches_of(one.id) for one in own]))
        found = chromaticity(learnt.swatches_of(part.id))
        assert np.linalg.norm(found[:, None] - worn, axis=2).min(axis=1).max() < 0.06, part.name
    assert len(learnt.swatches_of(SIX.part_id["upper_arms"])) == 2


def test_what_cannot_be_learnt_from_is_named(rig_session, rig_labels):
    with pytest.raises(CloudError, match="holds no corrected frame"):
        corrected_frames(rig_labels)
    with pytest.raises(CloudError, match="no frame 'x'"):
        list(clouds_with(rig_labels, ["x"], Session(rig_session)))
    with pytest.raises(CloudError, match="head shows 0 readable colours"):
        suit_from_labels([], "s")


def swatches(path: Path, columns: int, shown: int = 11) -> Path:
    """A photograph of the default suit's cloths on grey-white paper, with noise."""
    image = np.full((420, 560, 3), (206, 204, 198), np.uint8)
    for i in range(shown):
        row, column = divmod(i, columns)
        color = DEFAULT_SUIT.swatches_of(i % 11 + 1)[0] // (4 if i % 11 == 0 else 1)
        image[30 + 90 * row : 90 + 90 * row, 30 + 90 * column : 90 + 90 * column] = color
    noise = np.random.default_rng(0).normal(0, 3, image.shape)
    cv2.imwrite(str(path), np.clip(image + noise, 0, 255).astype(np.uint8)[..., ::-1])
    return path


@pytest.mark.parametrize("columns", [3, 4, 6])
def test_a_palette_is_learnt_from_a_photograph(tmp_path, columns):
    learnt = suit_from_photo(swatches(tmp_path / "cloths.png", columns), "cloths")
    assert len(learnt.parts) == 11
    assert max(nearest(DEFAULT_SUIT, learnt).values()) < 0.03


def test_bare_hands_and_feet_are_left_out_of_a_photograph(tmp_path):
    learnt = suit_from_photo(swatches(tmp_path / "cloths.png", 4), "cloths", HANDS)
    assert learnt.scheme == HANDS and learnt.parts.tolist() == [*range(1, 12)]
    with pytest.raises(CloudError, match=r"show 12 patches; lay 15 apart .* left_foot, right_foot"):
        suit_from_photo(swatches(tmp_path / "twelve.png", 4, 12), "s", HANDS)


def test_a_photograph_taken_with_the_telephone_on_its_side_shows_the_cloths_upright(tmp_path):
    """EXIF orientation 6: a viewer turns the stored pixels clockwise by a quarter."""
    with Image.open(swatches(tmp_path / "cloths.png", 4)) as upright:
        exif = Image.Exif()
        exif[0x112] = 6
        lying = upright.transpose(Image.Transpose.ROTATE_90)
        lying.save(tmp_path / "lying.jpg", exif=exif, quality=98, subsampling=0)
    learnt = suit_from_photo(tmp_path / "lying.jpg", "cloths")
    assert max(nearest(DEFAULT_SUIT, learnt).values()) < 0.03


def test_a_photograph_of_something_else_is_refused(tmp_path):
    with pytest.raises(CloudError, match="show 9 patches; lay 11 apart"):
        suit_from_photo(swatches(tmp_path / "nine.png", 4, 9), "s")
    (tmp_path / "text.png").write_text("no picture")
    for path in (tmp_path / "text.png", tmp_path / "absent.png"):
        with pytest.raises(CloudError, match="cannot be read"):
            suit_from_photo(path, "s")


def test_the_command_learns_a_palette_that_label_takes(annotate_cloud, tmp_path, rig_session):
    out, truth = tmp_path / "suit.toml", rig_session.with_suffix(".truth")
    learn = ("suit", "learn", truth, "--session", rig_session, "--out", out)
    assert annotate_cloud(*learn, "--json").result["suit"] == str(out)
    assert load_suit(out).name == "suit"
    assert_refused(annotate_cloud(*learn), out, "already exists")
    assert annotate_cloud("suit", "learn", "--out", out, "--overwrite").code == 2


def test_a_palette_at_its_bounds_is_read_and_beyond_them_refused(tmp_path, monkeypatch):
    path = tmp_path / "suit.toml"
    path.write_text(suit_to_toml(DEFAULT_SUIT))
    colors = len(DEFAULT_SUIT.parts)
    monkeypatch.setattr("annotate.suit.palette.MAX_SWATCHES", colors)
    monkeypatch.setattr("annotate.suit.palette.MAX_TOML_BYTES", path.stat().st_size)
    assert len(load_suit(path).parts) == colors
    monkeypatch.setattr("annotate.suit.palette.MAX_SWATCHES", colors - 1)
    with pytest.raises(CloudError, match=f"has {colors} colours; give at most {colors - 1}"):
        load_suit(path)
    monkeypatch.setattr("annotate.suit.palette.MAX_TOML_BYTES", path.stat().st_size - 1)
    with pytest.raises(CloudError, match="give a palette file"):
        load_suit(path)


def test_all_lights_at_once_match_as_one_by_one():
    rng = np.random.default_rng(3)
    palette, chroma, noise = unfitted(DEFAULT_SUIT), rng.uniform(0.1, 0.6, (7, 2)), rng.uniform(0.01, 0.3, 7)
    gains = GAIN + rng.uniform(-0.7, 0.7, (5, 2))
    expected = [under(palette, gain).match(chroma, noise) for gain in gains]
    np.testing.assert_allclose(palette.match_under(gains, chroma, noise), expected, rtol=1e-3, atol=1e-4)


def test_a_part_is_explained_by_the_best_of_its_swatches():
    palette = unfitted(DEFAULT_SUIT)
    match = np.random.default_rng(4).normal(size=(len(palette.wears), 9)).astype(np.float32)
    for part, best in enumerate(palette.by_part(match)):
        np.testing.assert_array_equal(best, match[palette.parts_worn[:, part]].max(axis=0))


def test_the_likelihood_of_a_colour_is_that_of_a_normal_distribution():
    rng = np.random.default_rng(5)
    model, chroma, noise = unfitted(DEFAULT_SUIT), rng.uniform(0.1, 0.6, (7, 2)), rng.uniform(0.01, 0.1, 7)
    for k, row in enumerate(model.match(chroma, noise)):
        for i, found in enumerate(row):
            spread = model.unknown[k] + (model.variance[k] + noise[i] ** 2) * np.eye(2)
            away = chroma[i] - (model.lit + model.shift)[k]
            log = -0.5 * away @ np.linalg.solve(spread, away) - 0.5 * np.log(np.linalg.det(spread))
            assert found == pytest.approx(log + 2 * np.log(SIGMA) - BARE_COST * model.bare[k], rel=1e-3)
