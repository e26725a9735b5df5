"""Suits of any scheme: files, cloths on the body, likelihoods by region."""

import re
from dataclasses import replace

import numpy as np
import pytest

from annotate.label_recording import SuitLabeller, label_cloud
from annotate.parts import BODY_PARTS, PAPER
from annotate.scheme.merging import class_shares, class_sums
from annotate.scheme.regions import Region
from annotate.scheme.scheme import Part, scheme_of
from annotate.scheme.scheme_file import SHIPPED, load_scheme, scheme_to_toml
from annotate.segmentation.input_channels import CHANNELS, Rectangle
from annotate.segmentation.segment import View
from annotate.segmentation.suit_network import shipped_suit_network
from annotate.suit.color_model import unfitted
from annotate.suit.palette import (
    DEFAULT_SUIT,
    MIN_CHROMA_DISTANCE,
    Suit,
    chromaticity,
    load_suit,
    suit_from_toml,
    suit_to_toml,
)
from sensors.errors import CloudError
from synth.appearance.outfit import dress
from synth.appearance.pattern import FIRST_CLOTH, FIRST_SEAM, SKIN, pattern_of
from synth.appearance.photograph import CLEAN, NORMAL
from synth.appearance.random_suit import random_suit
from synth.body.atlas_border import face_regions
from synth.body.body import shipped_bodies
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import RigOptions, VirtualRig
from tests.helpers.schemes import WARD, frame_in

SCHEMES = [*map(load_scheme, SHIPPED), WARD]
HANDS, KINECT = load_scheme("hands-and-feet"), load_scheme("kinect")
CHAIR = scheme_of("chair", [*PAPER.parts, Part(12, "wheelchair", "Wheelchair", (9, 200, 9))])
SUITS = [random_suit(3, scheme=scheme) for scheme in (load_scheme("six"), load_scheme("atlas"), WARD)]


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_a_suit_s_file_needs_no_other_file(scheme):
    suit = random_suit(5, scheme=scheme)
    again = suit_from_toml(suit_to_toml(suit), "suit")
    assert again.scheme == suit.scheme == scheme and again.name == suit.name
    for part in scheme.parts:
        np.testing.assert_array_equal(again.swatches_of(part.id), suit.swatches_of(part.id))
    assert ("scheme" in suit_to_toml(suit)) == (scheme != PAPER)


def test_a_suit_s_scheme_is_a_file_beside_it(tmp_path):
    text = suit_to_toml(SUITS[2]).partition("[scheme]")[0]
    (tmp_path / "ward.toml").write_text(scheme_to_toml(WARD))
    (tmp_path / "suit.toml").write_text('scheme = "ward.toml"\n' + text)
    assert load_suit(tmp_path / "suit.toml").scheme == WARD


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ('scheme = "absent"\n[colors]\n', "scheme 'absent' does not exist"),
        ("scheme = 7\n[colors]\n", "has scheme 7; give the name"),
        ('scheme = "six"\n[colors]\nhip = "#102030"\n', "'hip' is not a part; use head, torso, upper_arms"),
        ('scheme = "six"\n[colors]\nhead = "#102030"\n', "no colour for torso"),
        ('scheme = "six"\n', r"no \[colors\] table; list the 6 parts"),
        ("[scheme]\nname = 'x'\nparts = 7\n[colors]\n", "the scheme has no parts"),
    ],
)
def test_a_wrong_suit_is_named_in_one_line(text, fault):
    with pytest.raises(CloudError, match=fault) as refusal:
        suit_from_toml(text, "suit x.toml")
    assert "\n" not in str(refusal.value)


def test_a_thing_wears_no_suit():
    text = suit_to_toml(SUITS[2]).replace("[colors]", '[colors]\nwheelchair = "#102030"')
    with pytest.raises(CloudError, match="'wheelchair' is not a part"):
        suit_from_toml(text, "suit")
    for thing in ("wheelchair", "blanket"):
        assert not re.search(f"^{thing} =", suit_to_toml(SUITS[2]), re.MULTILINE)


@pytest.mark.parametrize("suit", [DEFAULT_SUIT, *SUITS], ids=lambda suit: suit.scheme.name)
def test_a_part_of_the_paper_is_as_likely_as_its_likeliest_region(suit):
    """Against loops over swatches and regions."""
    model = unfitted(suit)
    match = np.random.default_rng(4).normal(size=(len(model.wears), 9)).astype(np.float32)
    by_region = model.by_region(match)
    for region in Region:
        own = suit.parts == suit.scheme.table[region]
        assert model.wears[: len(own), region - 1].tolist() == own.tolist()
        np.testing.assert_array_equal(by_region[region - 1], match[model.wears[:, region - 1]].max(axis=0))
    for part, likely in zip(BODY_PARTS, model.by_part(match), strict=True):
        regions = [region - 1 for region in Region if PAPER.table[region] == part.id]
        np.testing.assert_array_equal(likely, by_region[regions].max(axis=0))


@pytest.mark.parametrize("name", ["paper", "kinect", "atlas"])
def test_skin_is_the_head_s_and_not_the_neck_s(name):
    """A neck that is a part of its own has a cloth."""
    scheme = load_scheme(name)
    model = unfitted(random_suit(5, scheme=scheme))
    skin = next(row for row, bare in zip(model.worn_in(scheme), model.bare, strict=True) if bare)
    head, neck = (scheme.table[region] for region in (Region.HEAD, Region.NECK))
    shown = scheme.class_ids[scheme.body_classes][skin]
    assert head in shown and (neck in shown) == (neck == head)


@pytest.mark.parametrize("suit", [DEFAULT_SUIT, *SUITS], ids=lambda suit: suit.scheme.name)
def test_a_seam_without_stray_is_the_border_of_the_parts(suit):
    body = shipped_bodies()[1]
    outfit = dress(body, suit, CLEAN.wear, np.random.default_rng(0))
    centre, pattern = outfit.fields_m[body.faces].mean(axis=1), pattern_of(suit)
    zones = pattern.zone_of_region[face_regions(body)]
    for n, (first, second) in enumerate(pattern.seams, FIRST_SEAM):
        assert (centre[zones == first, n] <= 0).all()
        assert (centre[zones == second, n] >= 0).all()
    np.testing.assert_array_equal(outfit.face_rgb(body.faces), outfit.zone_rgb[zones])
    parts = suit.scheme.table[face_regions(body)]
    for zone, part in enumerate(pattern.parts, FIRST_CLOTH):
        np.testing.assert_array_equal(zones == zone, parts == part)


@pytest.mark.parametrize("name", SHIPPED[1:])
def test_a_scheme_s_random_suits_have_one_cloth_a_part_all_apart(name):
    scheme = load_scheme(name)
    suits = [random_suit(seed, scheme=scheme) for seed in range(12)]
    for suit in suits:
        assert suit.scheme == scheme and suit.parts.tolist() == [part.id for part in scheme.parts]
        chroma = chromaticity(suit.colors_rgb)
        gaps = np.linalg.norm(chroma[:, None] - chroma[None], axis=2)[np.triu_indices(len(chroma), 1)]
        assert gaps.min() > MIN_CHROMA_DISTANCE and not suit.look_alikes
    assert len({suit.colors_rgb.tobytes() for suit in suits}) == len(suits)


def test_a_bare_hand_is_skin_a_glove_is_cloth_and_no_suit_changes_the_other_random_numbers():
    scheme, body = load_scheme("hands-and-feet"), shipped_bodies()[3]
    gloves = random_suit(4, scheme=scheme)
    bare = [part.id for part in scheme.parts if part.name.endswith(("hand", "foot"))]
    kept = ~np.isin(gloves.parts, bare)
    barefoot = Suit("barefoot", gloves.colors_rgb[kept], gloves.parts[kept], scheme)
    hand = np.isin(face_regions(body), [Region.LEFT_HAND, Region.LEFT_FINGERS])
    following = set()
    for suit, skin in ((DEFAULT_SUIT, None), (gloves, False), (barefoot, True), (SUITS[0], None)):
        rng = np.random.default_rng(8)
        outfit = dress(body, suit, NORMAL.wear, rng)
        is_skin = (outfit.face_rgb(body.faces)[hand] == outfit.zone_rgb[SKIN]).all(axis=1)
        assert skin is None or (is_skin == skin).all()
        following.add(float(rng.random()))
    assert len(following) == 1


def test_a_coarse_suit_is_open_at_hands_and_feet_alone():
    """A scheme whose arms reach to the shoulder, and whose head and trunk are one part."""
    head, torso = load_scheme("six").parts[:2]
    arms = frozenset(r for r in Region if r.label.endswith(("_arm", "forearm", "hand", "fingers")))
    parts = [replace(head, regions=frozenset(Region) - arms), replace(torso, regions=arms)]
    scheme = scheme_of("two", parts)
    suit, body = random_suit(2, scheme=scheme), shipped_bodies()[3]
    outfit = dress(body, suit, replace(NORMAL.wear, hood_down=1.0), np.random.default_rng(1))
    regions = face_regions(body)
    rgb, colors = outfit.face_rgb(body.faces), outfit.cloth_rgb
    bare = (rgb != colors[scheme.table[regions] - 1]).any(axis=1)
    shown = {Region(region).label.removeprefix("left_").removeprefix("right_") for region in regions[bare]}
    ends = {"head", "neck", "hand", "fingers", "foot", "toes"}
    assert ends <= shown <= ends | {"forearm", "lower_leg"}


def in_gloves(alike: bool = False) -> Suit:
    """A suit with gloves and socks of their own; alike: the gloves have their sleeves' colours."""
    suit = random_suit(4, scheme=HANDS)
    rgb = suit.colors_rgb.copy()
    if alike:
        rgb[HANDS.part_id["left_hand"] - 1] = rgb[HANDS.part_id["left_forearm"] - 1]
    return replace(suit, colors_rgb=rgb)


def test_labels_have_the_suit_s_parts_where_its_colours_tell_them_apart():
    network, gloves = shipped_suit_network(), in_gloves()
    covered = np.flatnonzero(gloves.parts < 12)
    bare = replace(gloves, colors_rgb=gloves.colors_rgb[covered], parts=gloves.parts[covered])
    for suit, scheme in (
        (None, PAPER),
        (DEFAULT_SUIT, PAPER),
        (gloves, HANDS),
        (bare, PAPER),
        (in_gloves(alike=True), PAPER),
        (random_suit(4, scheme=load_scheme("six")), PAPER),
        (random_suit(4, scheme=load_scheme("trunk-and-limbs")), PAPER),
        (random_suit(4, scheme=KINECT), KINECT),
        (SUITS[2], WARD),
    ):
        assert network.for_suit(suit).scheme == SuitLabeller(suit).scheme == scheme
        states = suit is not None and suit.scheme != scheme
        notes = [note for note in SuitLabeller(suit).notes if "labels have the parts of" in note]
        assert len(notes) == states, notes
    assert network.scheme == PAPER


def test_a_suit_of_the_network_s_parts_keeps_its_things():
    """A network that has learnt a wheelchair, and the same suit as before."""
    taught = shipped_suit_network().labelling(CHAIR)
    vars(taught)["own"] = CHAIR
    for suit, scheme, lost in (
        (DEFAULT_SUIT, CHAIR, []),
        (replace(DEFAULT_SUIT, scheme=CHAIR), CHAIR, []),
        (random_suit(4, scheme=load_scheme("six")), CHAIR, []),
        (in_gloves(), HANDS, ["wheelchair"]),
        (SUITS[2], WARD, []),
    ):
        labeller = SuitLabeller(suit, taught.for_suit(suit))
        assert labeller.scheme == scheme
        assert [note.split()[2] for note in labeller.notes if "labels lack" in note] == lost


@pytest.mark.parametrize("live", [False, True])
def test_kinect_s_pelvis_is_labelled_by_its_colour(live):
    rig = VirtualRig(1, 1, "clean", 5, RigOptions(draft=True, scheme=KINECT))
    ((frame, truth),) = rig.with_truth()
    true = truth_labels(frame, truth, rig.calibration.depth, KINECT).parts
    labeller = SuitLabeller(rig.suit, single_pass=live)
    found, _ = label_cloud(labeller, labeller.fuser(rig.calibration).fuse_frame(frame), None)
    assert found.scheme == KINECT
    for name in ("pelvis", "spine_navel", "spine_chest", "hip_left", "hip_right"):
        part = KINECT.part_id[name]
        assert (found.parts[true == part] == part).mean() > 0.7, name


@pytest.mark.parametrize("scheme", [HANDS, WARD, load_scheme("atlas")], ids=lambda scheme: scheme.name)
def test_shares_of_a_divided_class_are_equal_and_add_up(scheme):
    chance = np.random.default_rng(0).random((13, 4, 5)).astype(np.float32)
    shares = class_shares(chance, PAPER, scheme)
    np.testing.assert_allclose(class_sums(shares, scheme, PAPER), chance, rtol=1e-6)
    for part in PAPER.parts:
        rows = scheme.class_table[list(scheme.ids_of(part.regions))]
        assert (shares[rows] == shares[rows[0]]).all()


@pytest.mark.parametrize("live", [False, True])
def test_gloves_and_socks_are_labelled_by_their_colours(live):
    rig = VirtualRig(1, 1, "clean", 5, RigOptions(draft=True, suit=in_gloves(), scheme=HANDS))
    ((frame, truth),) = rig.with_truth()
    true = truth_labels(frame, truth, rig.calibration.depth, HANDS).parts
    labeller = SuitLabeller(rig.suit, single_pass=live)
    found, _ = label_cloud(labeller, labeller.fuser(rig.calibration).fuse_frame(frame), None)
    assert found.scheme == HANDS
    # The confidence of a divided class is the sum of its shares.
    assert found.confidence[np.isin(true, [HANDS.part_id["left_hand"], HANDS.part_id["hip"]])].mean() > 0.8
    for name in ("left_hand", "right_hand", "left_foot", "right_foot", "left_forearm"):
        part = HANDS.part_id[name]
        assert (found.parts[true == part] == part).mean() > 0.7, name


def test_earlier_labels_that_do_not_convert_are_no_input():
    where = Rectangle(slice(0, 24), slice(0, 32))
    empty = np.zeros((len(CHANNELS), 24, 32), np.uint8)
    view = View(where, empty, np.zeros((24, 32, 3), np.uint8), 100.0, np.zeros((0, 3), np.uint8))
    assert not view.after(frame_in(load_scheme("six")), None).planes.any()
    assert view.after(frame_in(HANDS), None).planes.any()
