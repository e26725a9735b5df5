"""Things near a subject keep out of its way, and people do not overlap."""

from dataclasses import replace
from functools import cache
from itertools import islice

import numpy as np
import pytest
from scipy.spatial import cKDTree

from annotate.parts import PAPER_PARTS, PART_ID
from annotate.scheme.regions import N_REGIONS
from annotate.suit.palette import DEFAULT_SUIT
from synth.body.body import shipped_bodies
from synth.body.skeleton import JOINT_ID
from synth.data_files import CASTS, TRAINING
from synth.pose.postures import SITTING
from synth.rig.difficulty import CLEAN, HARD, NORMAL, Clutter
from synth.rig.episode import Episode, EpisodeSetup, Scene, SceneState
from synth.rig.locations import SCENES, located
from synth.rig.objects_nearby import laptop, mug
from synth.surface.furniture import Surface

FURNISHED = ("sofa", "chair", "bed")
BODY = shipped_bodies()[3]
EVERYTHING = replace(HARD, clutter=Clutter(**dict.fromkeys(vars(Clutter()), 1.0)))


def episode(scene="sofa", difficulty=EVERYTHING, number=0, seed=1, people=TRAINING):
    place = located(scene, people)
    return Episode(EpisodeSetup(place, difficulty, DEFAULT_SUIT, seed, 2.0, cast=people), number)


@cache
def played(scene: str, number: int, people: str = TRAINING) -> tuple[Scene, list[SceneState]]:
    """The cast of a stay with everything, and its first three moments; people: of the data's cast."""
    made = episode(scene, number=number, people=people)
    return made.scene, list(islice(made.states(), 3))


def vertices_of(cast, tableau, *tags):
    return tableau.vertices_m[np.unique(cast.faces[np.isin(cast.tags, tags)])]


@pytest.mark.parametrize("scene", SCENES)
def test_a_stay_is_the_same_twice_and_its_arrays_fit(scene):
    cast, moments = played(scene, 0)
    for a, b in zip(moments, episode(scene).states(), strict=False):
        np.testing.assert_array_equal(a.vertices_m, b.vertices_m)
        np.testing.assert_array_equal(a.celsius, b.celsius)
        assert a.vertices_m.shape == a.following_m.shape and np.isfinite(a.vertices_m).all()
        assert len(cast.faces) == len(cast.tags) == len(a.celsius) == len(cast.dark) - 1
        assert cast.faces.max() == len(a.vertices_m) - 1
        assert (np.isfinite(a.celsius) & (a.celsius > 5) & (a.celsius < 90)).all()
        assert ((cast.dark >= 0) & (cast.dark <= 1)).all()
        own = cast.tags <= N_REGIONS
        assert cast.faces[own].max() < cast.subject <= cast.people
        assert cast.faces[cast.tags == Surface.OTHER_PERSON].max(initial=cast.subject) < cast.people


def test_what_follows_is_the_next_moment():
    a, b = islice(episode(difficulty=NORMAL).states(), 2)
    np.testing.assert_array_equal(a.following_m, b.vertices_m)
    assert np.abs(a.following_m - a.vertices_m).max() > 1e-4


@pytest.mark.parametrize("people", CASTS)
@pytest.mark.parametrize("scene", SCENES)
def test_visitors_touch_nobody_and_stand_on_the_floor(scene, people):
    stays = [played(scene, k, people) for k in range(3)]
    visited = [
        (cast, tableau) for cast, moments in stays if cast.people > cast.subject for tableau in moments
    ]
    assert visited
    for cast, tableau in visited:
        subject, people = cast.subject, cast.people
        visitor = tableau.vertices_m[subject:people]
        gap, _ = cKDTree(tableau.vertices_m[:subject][::5]).query(visitor[::5])
        assert gap.min() > 0.05
        # In one stay by the wheelchair the feet of a short visitor hang from a high chair.
        assert -0.03 < visitor[:, 2].min() < (0.08 if scene == "wheelchair" else 0.05)
        if scene in ("sofa", "bed"):
            seat = vertices_of(cast, tableau, Surface.SOFA, Surface.BED)[:8]
            inside = (visitor > seat.min(axis=0) + 0.01) & (visitor < seat.max(axis=0) - 0.01)
            assert not inside.all(axis=1).any()


@pytest.mark.parametrize("people", CASTS)
@pytest.mark.parametrize("scene", FURNISHED)
def test_blankets_lie_over_the_legs(scene, people):
    cast, moments = played(scene, 1, people)
    legs = [PART_ID[f"{s}_{p}"] for s in ("left", "right") for p in ("upper_leg", "lower_leg")]
    for tableau in moments:
        cloth = vertices_of(cast, tableau, Surface.BLANKET)
        leg = vertices_of(cast, tableau, *np.flatnonzero(np.isin(PAPER_PARTS, legs)))
        low, high = cloth[:, :2].min(axis=0), cloth[:, :2].max(axis=0)
        covered = leg[((leg[:, :2] > low) & (leg[:, :2] < high)).all(axis=1)]
        assert len(covered) > 200
        # The nearest node beside a point of the leg is not lower than it, but where the cloth hangs down.
        _, nearest = cKDTree(cloth[:, :2]).query(covered[:, :2])
        assert (cloth[nearest, 2] >= covered[:, 2] - 0.005).mean() > 0.97


def test_a_laptop_is_on_free_thighs_and_else_aside():
    rng, place = np.random.default_rng(3), located("sofa")(np.random.default_rng(0))
    thing = laptop(np.array([9.0, 9.0, 0.5]), BODY, on_lap=True)
    places, legs = {}, np.zeros(len(BODY.vertices_m), bool)
    for name in ("left_upper_leg", "right_upper_leg", "left_lower_leg", "right_lower_leg"):
        legs[BODY.faces[BODY.face_parts == PART_ID[name]]] = True
    for activity in ("gadget", "resting", "leaning_forward", "reading"):
        for _ in range(4):
            person, joints = place.behaviour.pose(BODY, SITTING.draw(activity, rng))
            where = thing.vertices(person, joints)
            places.setdefault(activity, []).append(bool(where[0, 0] < 5))
            if where[0, 0] < 5:
                base = where[:8]
                inside = (person > base.min(axis=0) + 1e-4) & (person < base.max(axis=0) - 1e-4)
                assert not inside.all(axis=1).any()
                # Nothing but legs reaches past the hinge: no hand through the lid.
                low = ~legs & (np.abs(person[:, 0] - base[:, 0].mean()) < 0.16)
                low &= person[:, 2] < where[:, 2].max()
                assert person[low, 1].min() > base[:, 1].min()
                knee = joints[[JOINT_ID["left_knee"], JOINT_ID["right_knee"]], 2].max()
                assert knee - 0.12 < base[:, 2].min() < knee + 0.2
    assert any(places["gadget"]) and not any(places["leaning_forward"])


def test_a_mug_is_at_the_mouth_of_who_drinks_unless_it_stands():
    rng, place = np.random.default_rng(3), located("sofa")(np.random.default_rng(0))
    held, standing = (mug(np.array([9.0, 9.0, 0.5]), BODY, held=free) for free in (True, False))
    at_mouth = []
    for _ in range(8):
        person, joints = place.behaviour.pose(BODY, SITTING.draw("drinking", rng))
        away = np.linalg.norm(held.vertices(person, joints).mean(axis=0) - joints[JOINT_ID["head"]])
        at_mouth.append(away < 0.4)
        assert standing.vertices(person, joints)[:, 0].min() > 8
    assert any(at_mouth)
    person, joints = place.behaviour.pose(BODY, SITTING.draw("resting", rng))
    assert held.vertices(person, joints)[:, 0].min() > 8


def test_the_seat_is_warm_where_somebody_sits_and_the_room_even_when_clean():
    hard, clean = episode(difficulty=NORMAL), episode(difficulty=CLEAN)
    warm, cold = next(hard.states()), next(clean.states())
    seat_c = warm.celsius[hard.scene.tags == Surface.SOFA]
    assert seat_c.max() > hard.scene.room_c + 5 and np.median(seat_c) < hard.scene.room_c + 2
    lifeless = clean.scene.tags > N_REGIONS
    assert set(cold.celsius[lifeless]) == {clean.scene.room_c}


def test_subjects_are_of_many_builds():
    outfits = [episode(difficulty=CLEAN, number=k).scene.outfits[0] for k in range(8)]
    heights = [float(np.ptp(outfit.rest_m[:, 2])) for outfit in outfits]
    assert len(np.unique(np.round(heights, 4))) == 8 and np.ptp(heights) > 0.1


@pytest.mark.parametrize("people", CASTS)
@pytest.mark.parametrize("scene", SCENES)
def test_robots_look_at_the_person_from_a_robots_distance(scene, people):
    rng = np.random.default_rng(0)
    for _ in range(20):
        place = located(scene, people)(rng)
        pose = place.robot_eye(rng, 1.0)
        middle = pose.apply(np.array([[0, 0, place.furniture.height + 0.1 + 0.5 * (scene == "floor")]]))[0]
        assert 1.5 < middle[2] < 3.4 and abs(middle[0]) < 0.6 and abs(middle[1]) < 0.7
        eye = pose.inverse().translation_m
        assert 0.9 < eye[2] < 2.5 and place.room.front_y < eye[1] < place.wall_y - 0.2
        assert place.room.left_x + 0.1 < eye[0] < place.room.right_x - 0.1


def test_a_loose_suit_changes_the_persons_shape_and_nothing_else_about_the_stay():
    """Location, camera, light, colours by part and the visitor equal the tight suit's."""
    tight, loose = (episode(difficulty=replace(NORMAL, loose=share), number=1) for share in (0.0, 1.0))
    slim, wide = (next(s.states()) for s in (tight, loose))
    one, other = tight.scene, loose.scene
    np.testing.assert_array_equal(one.faces, other.faces)
    np.testing.assert_array_equal(one.tags, other.tags)
    np.testing.assert_array_equal(one.outfits[0].fields_m, other.outfits[0].fields_m)
    np.testing.assert_array_equal(one.outfits[0].zone_rgb, other.outfits[0].zone_rgb)
    np.testing.assert_array_equal(one.camera_from_world.translation_m, other.camera_from_world.translation_m)
    own = slice(0, tight.scene.subject)
    off = np.linalg.norm(slim.vertices_m[own] - wide.vertices_m[own], axis=1)
    assert np.quantile(off, 0.9) > 0.004 and off.max() < 0.3
    own = tight.scene.tags <= N_REGIONS
    assert wide.celsius[own].mean() < slim.celsius[own].mean()
