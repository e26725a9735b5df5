"""Track ids last over crossings and losses of two seconds; false detections of one frame have none."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.person.detection.finder import Person
from annotate.person.detection.odds import LIKELY_ODDS, SURE_ODDS, Evidence
from annotate.person.tracking import LOST_S, MOST_PERSONS, Sightings, Track, Tracks, assigned


def evidence_of(odds):
    """Evidence with given log odds, of which the mean log odds of pixels are a linear part."""
    zero, one = (Evidence(mean_odds, 0.5).odds for mean_odds in (0.0, 1.0))
    return Evidence((odds - zero) / (one - zero), 0.5)


SURE, LIKELY, WEAK = map(evidence_of, (SURE_ODDS + 1, LIKELY_ODDS + 1, LIKELY_ODDS - 1))


def person_at(place_m, evidence=SURE):
    return Person(np.ones((1, 1), np.bool_), 0.5, np.array(place_m, np.float64), evidence)


def walked(frames, seconds=0.1, subject=None):
    """Ids of the people of each frame; a frame is a list of people or of places on a line."""
    earlier, ids = None, []
    for index, people in enumerate(frames):
        people = [one if isinstance(one, Person) else person_at((one, 0.0, 2.0)) for one in people]
        sightings = Sightings(people, earlier, round(index * seconds * 1e9))
        numbers, tracks = sightings.numbered(subject if people else None)
        earlier = Tracks.of({"people": tracks.note()})
        ids.append(numbers)
    return ids


def test_ids_last_while_people_come_in_any_order():
    assert walked([(0.0, 1.0), (1.1, 0.1), (0.2, 1.2)]) == [[1, 2], [2, 1], [1, 2]]


def test_people_who_walk_past_each_other_keep_their_ids():
    """At a metre a second, one half a metre behind the other; the farther one is hidden meanwhile."""
    frames = []
    for x in np.arange(-1.0, 1.05, 0.1):
        near, far = person_at((x, 0, 2.0)), person_at((-x, 0, 2.5))
        frames.append([near] if abs(x) < 0.25 else [near, far] if x < 0 else [far, near])
    ids = walked(frames)
    assert ids[0] == [1, 2] and ids[-1] == [2, 1]


@pytest.mark.parametrize(("lost_s", "number"), [(LOST_S, 1), (LOST_S + 0.1, 2)])
def test_a_person_lost_for_two_seconds_keeps_the_id_and_a_later_one_has_another(lost_s, number):
    frames = [(0.0,), *[()] * round(10 * lost_s - 1), (0.3,)]
    assert walked(frames)[-1] == [number]


def test_a_lost_person_is_expected_on_the_way():
    track = Track(1, np.zeros(3), np.zeros(3), 0)
    for frame in range(1, 20):
        track = track.seen_again(np.array([0.1 * frame, 0.0, 0.0]), round(frame * 1e8))
    np.testing.assert_allclose(track.expected_m(0.3), (2.2, 0, 0), atol=0.05)


def test_a_doubtful_detection_of_one_frame_is_not_shown_and_one_that_lasts_is():
    flash, lasting = person_at((2, 0, 3), LIKELY), person_at((-2, 0, 3), LIKELY)
    ids = walked([(0.0,), (0.0, flash, lasting), (0.0, lasting), (0.0, lasting), (0.0, flash)])
    assert ids == [[1], [1, 0, 0], [1, 2], [1, 2], [1, 0]]
    assert walked([(0.0,), (0.0, person_at((2, 0, 3)))])[1] == [1, 2]  # a sure one is shown at once
    weak = person_at((2, 0, 3), WEAK)
    assert walked([(0.0,), (0.0, weak), (0.0, weak)])[-1] == [1, 0]


def test_a_shown_person_stays_shown_in_a_doubtful_frame():
    assert walked([(0.0,), (person_at((0.1, 0, 2), WEAK),)]) == [[1], [1]]


def test_a_single_image_shows_likely_persons():
    assert walked([[person_at((0, 0, 2), LIKELY), person_at((2, 0, 2), WEAK)]]) == [[1, 0]]


def test_likely_persons_of_unrelated_images_are_shown_but_no_flash_in_an_empty_room():
    one, other = (person_at((x, 0, 3), LIKELY) for x in (-2, 2))
    assert walked([[one], [other], [one]]) == [[1], [2], [1]]
    assert walked([[one], [other]], seconds=LOST_S + 0.1) == [[1], [2]]
    assert walked([[], [other], [], [one]]) == [[], [0], [], [0]]


def test_the_subject_has_id_1_and_an_earlier_subject_another():
    assert walked([(0.0, 1.0), (1.0, 0.0)], subject=0) == [[1, 2], [1, 3]]
    assert walked([(0.0, 1.0), (0.0, 1.0)], subject=0) == [[1, 2], [1, 2]]


def test_ids_are_new_until_all_are_used():
    places = [(10.0 * k,) for k in range(MOST_PERSONS + 2)]
    ids = [numbers[0] for numbers in walked(places, seconds=LOST_S + 0.1)]
    assert ids[:MOST_PERSONS] == list(range(1, MOST_PERSONS + 1)) and len(set(ids)) == MOST_PERSONS


@settings(max_examples=50)
@given(st.integers(0, 10**6), st.integers(1, 5), st.integers(1, 5))
def test_assignment_is_one_to_one_and_ignores_the_order_of_people(seed, people, others):
    rng = np.random.default_rng(seed)
    places = list(rng.uniform(-1, 1, (people, 3)))
    tracks = [Track(k + 1, at, np.zeros(3), 0) for k, at in enumerate(rng.uniform(-1, 1, (others, 3)))]
    found = assigned(places, tracks, 10**8)
    assert len(set(found.values())) == len(found)
    order = rng.permutation(people)
    turned = assigned([places[i] for i in order], tracks, 10**8)
    assert {int(order[i]): k for i, k in turned.items()} == found


KNOWN = {"id": 1, "at_mm": [0, 0, 2000], "mm_per_s": [0, 0, 0], "seen_ns": 0}
IMPOSSIBLE = [
    *({"id": 300}, {"id": -1}, {"at_mm": [float("nan")] * 3}, {"at_mm": [1e308, 0, 0]}, {"seen_ns": 10**400}),
    *({"mm_per_s": [1e308, 0, 0]}, {"mm_per_s": [10**400, 0, 0]}, {"at_mm": [float("inf"), 0, 0]}),
]
NOTED = {"stamp_ns": 0, "latest": 1}


def test_a_possible_note_has_tracks():
    tracks = Tracks.of({"people": NOTED | {"tracks": [KNOWN]}})
    assert [track.number for track in tracks.tracks] == [1]


@pytest.mark.parametrize(
    "note",
    [
        *(None, [], [[1, 0, 0, 2000]], {"tracks": [{"id": 1}]}, {"tracks": None}),
        *(NOTED | {"tracks": [KNOWN | change]} for change in IMPOSSIBLE),
        *(NOTED | change | {"tracks": [KNOWN]} for change in ({"latest": -5}, {"stamp_ns": 10**400})),
        NOTED | {"tracks": [KNOWN] * 1000},
    ],
)
def test_a_malformed_note_has_no_tracks(note):
    assert Tracks.of({"people": note}) is None
    assert Tracks.of({}) is None
