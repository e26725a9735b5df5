"""People are detected with and without temperature: in rooms, cut out, cut off, side by side."""

from functools import partial
from itertools import pairwise

import cv2
import numpy as np
import pytest

from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.person.detection import candidates, finder
from annotate.person.detection.finder_network import (
    DEPTH_INPUTS,
    FOCAL_PX,
    _network,
    network_input,
    odds_and_votes,
)
from annotate.person.detection.odds import KEPT_ODDS, Evidence
from annotate.person.detection.votes import MOST_PERSONS, Voters, grouped
from annotate.person.extract import PersonDetection
from sensors.rig.camera import Intrinsics
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import RigOptions, VirtualRig
from tests.helpers.furnished_room import CAMERA, celsius_of, cloud_of, seen


def survey_of(cloud):
    return PersonDetection(CoarseCloud.of(cloud))


def iou(found, truth):
    return (found & truth).sum() / (found | truth).sum()


def test_a_person_in_a_furnished_room_is_found():
    depth, whose = seen([(1, 0.0)])
    found = survey_of(cloud_of(depth)).person()
    assert found.method == "depth" and found.trusted and "depth alone" in found.notes[0]
    assert iou(found.mask, whose == 1) > 0.9 and not found.others.any()


@pytest.mark.parametrize("focal_px", [120.0, 182.5, 230.0, 365.0])
def test_the_surface_of_a_persons_votes_is_the_surface_of_the_mask(focal_px):
    side = round(2 * focal_px)
    camera = Intrinsics(side, side, focal_px, focal_px, (side - 1) / 2, (side - 1) / 2)
    cloud = cloud_of(seen([(1, 0.0)], camera=camera)[0], camera)
    unfelt = np.full(camera.shape, np.nan, np.float32)
    person = max(finder.find_people(cloud, unfelt), key=lambda person: person.odds)
    assert person.evidence.area_m2 == pytest.approx(person.area_m2, rel=0.15)


def test_empty_images_show_no_person():
    found = survey_of(cloud_of(seen([])[0])).person()
    assert not found.mask.any() and not found.others.any() and "no person" in found.notes[0]
    nothing = np.full(CAMERA.shape, np.nan, np.float32)
    assert finder.find_people(cloud_of(nothing), nothing) == []
    speck = Intrinsics(1, 1, 300.0, 300.0, 0.0, 0.0)
    assert finder.find_people(cloud_of(np.ones((1, 1)), speck), nothing[:1, :1]) == []


@pytest.mark.parametrize("is_felt", [False, True])
@pytest.mark.parametrize("apart", [0.5, 0.7, 1.1])
def test_two_who_stand_side_by_side_are_two(apart, is_felt):
    depth, whose = seen([(1, -apart / 2), (2, apart / 2)])
    found = survey_of(cloud_of(depth, celsius=celsius_of(whose) if is_felt else None)).person()
    one, other = (1, 2) if found.mask[whose == 1].mean() > 0.5 else (2, 1)
    assert iou(found.mask, whose == one) > 0.85 and iou(found.others, whose == other) > 0.85


@pytest.mark.parametrize("is_felt", [False, True])
def test_an_image_and_its_mirror_image_have_the_same_odds_and_votes_turned(is_felt):
    camera = Intrinsics(384, 318, FOCAL_PX, FOCAL_PX, 191.5, 158.5)
    depth, whose = seen([(1, -0.3), (2, 0.4)], camera=camera)
    points = np.nan_to_num(cloud_of(depth, camera).points_m)
    felt = (whose > 0).astype(np.float32) if is_felt else np.full(whose.shape, np.nan, np.float32)
    odds, votes = odds_and_votes(points, felt)
    other_odds, other_votes = odds_and_votes(
        points[:, ::-1] * np.array([-1, 1, 1], np.float32), felt[:, ::-1]
    )
    if is_felt:
        assert iou(other_odds[:, ::-1] > 0, odds > 0) > 0.9
    else:
        np.testing.assert_allclose(other_odds[:, ::-1], odds, atol=1e-4)
    # Of two columns side by side the left one votes.
    away = np.abs(other_votes[:, ::-1] * (-1, 1, 1) - votes)[odds[::2, ::2] > 0]
    assert (odds > 0).sum() > 2000 and np.median(away) < (0.04 if is_felt else 0.02)
    for number in (1, 2):
        middle = points[(whose == number) & (points[..., 2] > 0)].mean(axis=0)
        assert np.median(np.linalg.norm(votes[whose[::2, ::2] == number] - middle, axis=1)) < 0.12


@pytest.mark.parametrize("rows", [np.s_[:], np.s_[:150], np.s_[130:]])
def test_a_person_cut_out_is_all_that_is_there_whole_or_cut_off(rows):
    depth, whose = seen([(4, 0.0)], room=False)
    kept = np.zeros_like(whose)
    kept[rows] = whose[rows]
    cloud = cloud_of(np.where(kept > 0, depth, np.nan))
    assert iou(survey_of(cloud).person().mask, cloud.valid) > 0.98


def test_a_close_corner_of_a_room_is_no_cut_out_person(monkeypatch):
    monkeypatch.setattr(finder, "CUT_OUT_ODDS", 100.0)
    u = np.arange(CAMERA.width) - CAMERA.cx
    corner = np.broadcast_to(1 / (0.9 + 0.8 * np.abs(u) / CAMERA.fx), CAMERA.shape)
    assert (corner**2).sum() / CAMERA.fx**2 < finder.MOST_PERSON_M2
    nothing = np.full(CAMERA.shape, np.nan, np.float32)
    assert finder.find_people(cloud_of(corner), nothing) == []
    assert finder.find_people(cloud_of(np.where(np.abs(u) < 60, corner, np.nan)), nothing)


def test_noise_does_not_make_the_outline_flicker():
    masks = [survey_of(cloud_of(seen([(5, 0.1)], seed=seed)[0])).person().mask for seed in range(4)]
    assert min(iou(one, other) for one, other in pairwise(masks)) > 0.96


def test_a_camera_of_another_size_sees_the_same_person():
    fine = Intrinsics(640, 528, 458.0, 458.0, 319.5, 263.5)
    depth, whose = seen([(6, 0.0)], camera=fine)
    found = survey_of(cloud_of(depth, fine)).person().mask
    assert iou(found, whose == 6) > 0.9
    coarse = survey_of(cloud_of(seen([(6, 0.0)])[0])).person().mask
    assert iou(cv2.resize(found.astype(np.uint8), (320, 264)) > 0, coarse) > 0.93


def test_on_the_virtual_rig_without_temperatures():
    rig = VirtualRig(2, 2, "normal", 8104, RigOptions(draft=True))
    for frame, truth in rig.with_truth():
        labels = truth_labels(frame, truth)
        found = survey_of(Fuser(rig.calibration).fuse(frame.depth_mm)).person()
        known = labels.parts != 255
        assert iou(found.mask & known, (labels.persons == 1) & known) > 0.75


def voters_of(votes, points, odds=5.0):
    """Voters of a square millimetre a thousand, equally sure."""
    equal = np.full(len(votes), 0.001, np.float32)
    return Voters(votes.astype(np.float32), points.astype(np.float32), equal, odds * equal / 0.001)


def persons_by_votes(voters, least_odds=KEPT_ODDS):
    """Person numbers (n,) of voters, and the persons' evidence."""
    groups = grouped(voters)
    kept = [k for k, evidence in enumerate(groups.evidence) if evidence.odds >= least_odds]
    return groups.assigned(voters.votes_m, kept), [groups.evidence[k] for k in kept]


def test_votes_for_two_middles_are_two_persons_and_stray_ones_the_nearer_ones():
    rng = np.random.default_rng(0)
    middles = np.repeat([(-0.2, 0, 2), (0.2, 0, 2), (-0.6, 0, 2), (9, 9, 9)], (300, 300, 1, 1), axis=0)
    voters = voters_of(rng.normal(middles, 0.06), rng.normal(middles, (0.15, 0.4, 0.1)))
    whose, evidence = persons_by_votes(voters)
    assert set(whose[:300]) != set(whose[300:600]) and set(whose[:600]) == {1, 2} and len(evidence) == 2
    assert whose[600] == whose[0] and whose[601] == 0
    assert not persons_by_votes(voters._replace(surface_m2=voters.surface_m2 / 100))[0].any()
    assert persons_by_votes(voters.chosen(np.s_[:0]))[0].shape == (0,)


def test_a_detection_is_the_likelier_a_person_the_surer_its_pixels_and_the_larger_it_is():
    known = Evidence(3.0, 0.3)
    assert known._replace(mean_odds=4.0).odds > known.odds > known._replace(area_m2=0.1).odds
    rated = [known._replace(shape_odds=odds).odds for odds in (-4.0, 0.0, 4.0)]
    assert rated == sorted(rated) and rated[2] - rated[0] > 2


def test_a_limb_a_metre_nearer_whose_votes_fall_short_belongs_to_the_trunk():
    rng = np.random.default_rng(1)
    trunk, leg = rng.normal((0, 0, 3), (0.15, 0.3, 0.08), (300, 3)), rng.normal((0, 0.4, 2), 0.1, (150, 3))
    points = np.concatenate([trunk, leg])
    middle = (points / points[:, 2:]).mean(axis=0) * points[:, 2].mean()
    short = np.repeat([0.0, 0.6], (300, 150))[:, None] * (points - middle)
    votes = rng.normal(middle + short, 0.04)
    assert set(persons_by_votes(voters_of(votes, points))[0]) == {1}
    # The same limb whose votes meet in itself is another person, a child for instance.
    votes[300:] = rng.normal(leg.mean(axis=0), 0.04, (150, 3))
    votes[:300] = rng.normal(trunk.mean(axis=0), 0.04, (300, 3))
    assert set(persons_by_votes(voters_of(votes, points))[0]) == {1, 2}


def test_without_temperatures_fewer_inputs_give_the_same_result():
    depth, _ = seen([(1, 0.0)])
    given = network_input(depth.astype(np.float32) / 1000, np.full(depth.shape, np.nan, np.float32))
    assert not given[DEPTH_INPUTS:].any() and given[:DEPTH_INPUTS].any(axis=(1, 2)).all()
    given = given[None, :, :64, :64]
    fewer = _network(is_felt=False).run(None, {"image": given[:, :DEPTH_INPUTS]})[0]
    every = _network(is_felt=True).run(None, {"image": given})[0]
    np.testing.assert_allclose(fewer, every, atol=1e-5)
    assert np.ptp(every) > 1


def test_a_person_cut_out_needs_no_second_stage(monkeypatch):
    depth, whose = seen([(4, 0.0)], room=False)
    in_room, persons = seen([(4, 0.0)])
    rejected = partial(np.full, fill_value=-50, dtype=np.float32)
    monkeypatch.setattr(candidates, "person_odds", lambda crops: rejected(len(crops)))
    assert survey_of(cloud_of(np.where(whose > 0, depth, np.nan))).person().mask.any()
    assert not survey_of(cloud_of(in_room)).person().mask.any() and persons.any()


def test_a_temperature_without_depth_does_not_skip_the_second_stage(monkeypatch):
    depth = seen([(4, 0.0)])[0].copy()
    depth[:8] = np.nan
    warmth = np.full(CAMERA.shape, np.nan, np.float32)
    warmth[:8] = 0.5
    monkeypatch.setattr(candidates, "person_odds", lambda crops: np.full(len(crops), -50, np.float32))
    assert finder.find_people(cloud_of(depth), warmth) == []


def test_more_candidates_than_numbers_of_persons_and_unusual_cameras_are_no_error(monkeypatch):
    unfelt = np.full(CAMERA.shape, np.nan, np.float32)
    for focal_px in (1e-6, 1.0, 1e12):
        camera = Intrinsics(9, 7, focal_px, focal_px, 4.0, 3.0)
        assert finder.find_people(cloud_of(np.full((7, 9), 65.535), camera), unfelt[:7, :9]) == []

    def votes_apart(points_m, warmth):
        return np.full(points_m.shape[:2], 5, np.float32), 3 * points_m[::2, ::2]

    monkeypatch.setattr(finder, "odds_and_votes", votes_apart)
    monkeypatch.setattr(candidates, "person_odds", lambda crops: np.full(len(crops), -50, np.float32))
    found = finder.find_people(cloud_of(np.full(CAMERA.shape, 6.0)), unfelt)
    assert len(found) == MOST_PERSONS and (sum(person.mask.astype(int) for person in found) <= 1).all()
    assert max(person.odds for person in found) > 0


def test_where_the_background_is_cut_away_one_person_is_sure_and_others_need_evidence(monkeypatch):
    depth, whose = seen([(1, -0.5), (2, 0.6)], room=False)
    nothing = np.full(CAMERA.shape, np.nan, np.float32)

    def likely(points_m, warmth):
        odds, votes = odds_and_votes(points_m, warmth)
        return np.full_like(odds, least - finder.CUT_OUT_ODDS), votes

    monkeypatch.setattr(finder, "odds_and_votes", likely)
    cloud = cloud_of(np.where(whose > 0, depth, np.nan))
    for least in (4.0, 9.0):
        found = finder.find_people(cloud, nothing, -np.inf)
        means = sorted(person.evidence.mean_odds for person in found)
        assert len(found) == 2
        assert means == pytest.approx([least - finder.CUT_OUT_ODDS, least], abs=1e-4)
    monkeypatch.setattr(finder, "_is_cut_out", lambda *_: False)
    monkeypatch.setattr(finder, "rated", lambda found: found)
    equal = [person.evidence.mean_odds for person in finder.find_people(cloud, nothing, -np.inf)]
    assert equal == pytest.approx([5.0] * len(equal))
