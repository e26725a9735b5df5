"""Schemes: shipped ones pass all checks; tables, twins, neighbours and merging agree with naive code."""

import itertools
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.color import deltaE_cie76, rgb2lab

from annotate.parts import palette_rgb
from annotate.scheme.checks import color_faults, identity_faults, pair_faults, region_faults
from annotate.scheme.colours import OTHER_DISTANCE, lab, near_pairs, with_proposed_colors
from annotate.scheme.merging import conversion_table, converts, finest_common
from annotate.scheme.regions import REGION_NEIGHBOURS, Region, swap_regions
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Part, scheme_of
from annotate.scheme.scheme_file import SHIPPED, load_scheme
from sensors.errors import FormatError
from tests.helpers.schemes import BLACK, BODY, is_coarser, schemes

law = settings(deadline=None, max_examples=40)
ALL_IDS = np.arange(256, dtype=np.uint8)
PAPER = [
    ("head", "Head", (227, 57, 69), "2"),
    ("torso", "Torso", (66, 95, 167), "W"),
    ("left_upper_arm", "Left upper arm", (44, 156, 142), "3"),
    ("right_upper_arm", "Right upper arm", (212, 114, 35), "1"),
    ("left_forearm", "Left forearm", (151, 228, 183), "E"),
    ("right_forearm", "Right forearm", (255, 206, 57), "Q"),
    ("hip", "Hip", (203, 176, 255), "S"),
    ("left_upper_leg", "Left upper leg", (0, 120, 222), "D"),
    ("right_upper_leg", "Right upper leg", (212, 50, 123), "A"),
    ("left_lower_leg", "Left lower leg", (94, 203, 217), "C"),
    ("right_lower_leg", "Right lower leg", (200, 148, 88), "Z"),
]
"""Parts of version 0.3, by id from 1."""
PAPER_TWINS = ((3, 4), (5, 6), (8, 9), (10, 11))
PAPER_NEIGHBOURS = ((1, 2), (2, 3), (2, 4), (3, 5), (4, 6), (2, 7), (7, 8), (7, 9), (8, 10), (9, 11))

# Shipped schemes


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_schemes_pass_all_checks(name):
    scheme = load_scheme(name)
    assert scheme.name == name
    assert [part.id for part in scheme.parts] == [*range(1, scheme.n_classes)]
    for faults in (identity_faults(scheme.parts), region_faults(scheme.parts), color_faults(scheme, name)):
        assert [*faults] == []
    assert all(part.key and part.title for part in scheme.parts)


def test_paper_is_as_in_version_0_3():
    scheme = load_scheme("paper")
    assert [(part.name, part.title, part.rgb, part.key) for part in scheme.parts] == PAPER
    assert scheme.twins == PAPER_TWINS
    assert scheme.neighbours == {frozenset(pair) for pair in PAPER_NEIGHBOURS}
    expected = np.zeros((256, 3), np.uint8)
    expected[[0, UNDEFINED]] = (24, 24, 28), (128, 128, 128)
    expected[1:12] = [rgb for _, _, rgb, _ in PAPER]
    np.testing.assert_array_equal(palette_rgb(), expected)


def test_smpl_has_the_order_of_the_joints():
    joints = (
        "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 "
        "left_foot right_foot neck left_collar right_collar head left_shoulder right_shoulder "
        "left_elbow right_elbow left_wrist right_wrist left_hand right_hand"
    )
    assert " ".join(part.name for part in load_scheme("smpl-24").parts) == joints


def test_keys_of_shipped_schemes_are_free_in_the_window():
    keys = pytest.importorskip("annotate.gui.state.keys", reason="the window needs the extra gui")
    taken = {key for command in keys.COMMANDS for key in command.keys}
    for name in SHIPPED:
        scheme = load_scheme(name)
        assert taken.isdisjoint(part.key for part in scheme.parts)
        assert {c.name: c.key for c in keys.part_commands(scheme)} == {
            **{part.name: part.key for part in scheme.parts},
            "background": "X",
        }


# Tables, twins, neighbours


@given(schemes())
@law
def test_tables_follow_from_the_regions(scheme):
    assert [*region_faults(scheme.parts)] == []
    for part in scheme.parts:
        assert {*np.flatnonzero(scheme.table == part.id)} == part.regions
    assert scheme.table[BACKGROUND] == BACKGROUND and (scheme.table[25:] == UNDEFINED).all()
    np.testing.assert_array_equal(
        scheme.table[swap_regions(ALL_IDS)], scheme.swap_left_right(scheme.table), "swap commutes"
    )
    np.testing.assert_array_equal(scheme.swap_left_right(scheme.twin_table), ALL_IDS)
    body = {part.id for part in scheme.parts if part.regions}
    assert {pair for pair in scheme.neighbours if pair <= body} == {
        frozenset(pair)
        for pair in ({int(scheme.table[one]) for one in regions} for regions in REGION_NEIGHBOURS)
        if len(pair) == 2
    }


@pytest.mark.parametrize("last", [0, 100])
def test_left_is_first_in_twins(last):
    """Ids count up, or down from ``last``, so that the right has the lower id."""
    for name in SHIPPED:
        scheme = scheme_of(name, [replace(p, id=abs(last - p.id)) for p in load_scheme(name).parts])
        assert len(scheme.twins) == len(load_scheme(name).twins)
        parts = {part.id: part for part in scheme.parts}
        for left, right in scheme.twins:
            assert parts[left].name == parts[right].name.replace("right", "left")


# Merging


@given(schemes(), schemes())
@law
def test_the_finest_common_scheme_is_the_join_of_both(one, other):
    common = finest_common(one, other)
    scheme = common.scheme
    assert is_coarser(scheme, one) and is_coarser(scheme, other)
    np.testing.assert_array_equal(common.from_first[one.table[BODY]], scheme.table[BODY])
    np.testing.assert_array_equal(common.from_second[other.table[BODY]], scheme.table[BODY])
    swapped = finest_common(other, one)
    assert is_coarser(swapped.scheme, scheme) and is_coarser(scheme, swapped.scheme)
    for faults in (identity_faults, region_faults):
        assert [*faults(scheme.parts)] == []
    things = [{part.name for part in each.parts if part.is_free} for each in (one, other, scheme)]
    assert things[2] == things[0] & things[1]


@given(schemes(), schemes(), schemes())
@law
def test_no_finer_scheme_is_common(one, other, third):
    common = finest_common(one, other).scheme
    assert is_coarser(third, common) == (is_coarser(third, one) and is_coarser(third, other))


@given(schemes(colored=True))
@settings(deadline=None, max_examples=10)
def test_a_scheme_shares_itself_with_itself(scheme):
    common = finest_common(scheme, scheme)
    used = [BACKGROUND, *(part.id for part in scheme.parts), UNDEFINED]
    assert common.scheme == scheme
    np.testing.assert_array_equal(common.from_first[used], used)
    np.testing.assert_array_equal(common.from_second, common.from_first)


@pytest.mark.parametrize(("one", "other"), [*itertools.combinations_with_replacement(SHIPPED, 2)])
def test_common_schemes_of_shipped_ones_have_colours_apart(one, other):
    first, second = load_scheme(one), load_scheme(other)
    common, swapped = finest_common(first, second), finest_common(second, first)
    assert common.scheme == swapped.scheme and [*near_pairs(common.scheme)] == []
    np.testing.assert_array_equal(common.from_first, swapped.from_second)
    assert max(Counter(part.name for part in common.scheme.parts).values()) == 1


@given(schemes(), schemes())
@law
def test_a_scheme_converts_if_it_is_finer(source, target):
    assert converts(source, target) == is_coarser(target, source)
    if not converts(source, target):
        with pytest.raises(FormatError, match="lies in several parts"):
            conversion_table(source, target)
        return
    table = conversion_table(source, target)
    np.testing.assert_array_equal(table[source.table[BODY]], target.table[BODY])
    for part in source.parts:
        if part.is_free:
            assert table[part.id] == target.part_id.get(part.name, BACKGROUND)


def test_hands_and_feet_become_the_paper_s_parts():
    fine, paper = load_scheme("hands-and-feet"), load_scheme("paper")
    assert finest_common(fine, paper).scheme is paper and not converts(paper, fine)
    joined = finest_common(load_scheme("paper"), load_scheme("kinect")).scheme
    assert "trunk" in joined.part_id or "torso" in joined.part_id
    assert joined.name == "paper-kinect"


# Colours


def test_normal_eyes_are_those_of_scikit_image():
    rgb = np.random.default_rng(0).integers(0, 256, (500, 3)).astype(np.uint8)
    assert (deltaE_cie76(lab(rgb)[0], rgb2lab(rgb)) < 0.1).all()


def things(count: int):
    """Return a scheme of things without colours, each beside two others."""
    parts = [Part(i, f"thing_{i}", f"Thing {i}", BLACK) for i in range(1, count + 1)]
    return scheme_of("things", parts, (), [frozenset((i, i % count + 1)) for i in range(1, count + 1)])


def atlas_and_things(count: int):
    """Return the 24 segments and things beside the hip, 24 + ``count`` parts without colours."""
    smpl = load_scheme("smpl-24").parts
    more = [Part(25 + i, f"thing_{i}", f"Thing {i}", BLACK) for i in range(count)]
    return scheme_of("drawn", [*smpl, *more], (), [frozenset((1, part.id)) for part in more])


@pytest.mark.parametrize(
    "scheme",
    [load_scheme("six"), things(17), things(30), atlas_and_things(6), things(254)],
    ids=lambda scheme: f"{len(scheme.parts)} parts",
)
def test_proposed_colours_pass_the_check(scheme):
    ids = [part.id for part in scheme.parts]
    proposed = with_proposed_colors(scheme, ids)
    assert [*near_pairs(proposed)] == [] and proposed == with_proposed_colors(scheme, ids)
    assert with_proposed_colors(proposed) == proposed
    assert [(p.id, p.name) for p in proposed.parts] == [(p.id, p.name) for p in scheme.parts]


def test_proposed_colours_show_on_a_white_page():
    scheme = atlas_and_things(6)
    proposed = with_proposed_colors(scheme, [part.id for part in scheme.parts])
    seen = lab([part.rgb for part in proposed.parts])
    assert np.linalg.norm(seen - lab([(255, 255, 255)]), axis=2).min() > 10


@given(schemes(), st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=10)
def test_only_missing_and_near_colours_change(scheme, seed):
    """The first part of a near pair keeps its colour."""
    rgb = np.random.default_rng(seed).integers(100, 256, (len(scheme.parts), 3)).tolist()
    own = [replace(part, rgb=tuple(color)) for part, color in zip(scheme.parts, rgb, strict=True)]
    given_ = scheme_of("own", own, scheme.twins, scheme.neighbours)
    proposed = with_proposed_colors(given_)
    changed = {old.id for old, new in zip(given_.parts, proposed.parts, strict=True) if old.rgb != new.rgb}
    assert [*near_pairs(proposed)] == []
    assert changed <= {pair.other.id for pair in near_pairs(given_)}


def test_near_pairs_state_the_worst_eyes():
    red_and_green = [Part(1, "a", "A", (200, 90, 90)), Part(2, "b", "B", (120, 130, 90))]
    (pair,) = near_pairs(scheme_of("x", red_and_green, (), [frozenset((1, 2))]))
    assert pair.eyes in ("protan", "deutan") and pair.distance < pair.required == 23
    assert [*near_pairs(scheme_of("x", red_and_green))] == []
    assert pair.distance > OTHER_DISTANCE


def test_a_thing_beside_too_many_parts_gets_no_colour():
    parts = [*things(60).parts]
    scheme = scheme_of("x", parts, (), [frozenset(p) for p in itertools.combinations(range(1, 61), 2)])
    with pytest.raises(FormatError, match="59 neighbours"):
        with_proposed_colors(scheme, range(1, 61))


def test_pairs_that_a_file_states_are_of_things():
    parts = (*load_scheme("paper").parts, Part(12, "a", "A", BLACK), Part(13, "b", "B", BLACK))
    assert [*pair_faults(parts, [(12, 13)], [frozenset((1, 12))])] == []
    for twins, neighbours, says in (
        ([(3, 12)], [], "follows from its regions"),
        ([(12, 12)], [], "'a' 2 times"),
        ([], [frozenset((7,))], "'hip' beside itself"),
    ):
        assert any(says in fault for fault in pair_faults(parts, twins, neighbours))


def test_every_region_is_in_one_part_of_every_shipped_scheme():
    for name in SHIPPED:
        assert Counter(r for part in load_scheme(name).parts for r in part.regions) == Counter(Region)
