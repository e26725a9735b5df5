"""Simulated walkers cross in front of the camera; crossings, returns and false ids are counted."""

from collections import Counter
from itertools import islice

import numpy as np

from eval.training.rooms.walkers import walking_scenes
from synth.data_files import TRAINING
from tools.tracks.crossings import Paths, crossings, tally


def paths_of(columns, ids, counted=None):
    columns, ids = (np.array(values).T for values in (columns, ids))
    shown = np.isfinite(columns) if counted is None else np.array(counted).T
    return Paths(columns.astype(float), ids, shown)


def test_two_people_cross_once_though_one_is_hidden_meanwhile():
    columns = [[0, 10, 20, 30, 40], [40, 30, np.nan, 10, 0]]
    assert crossings(np.array(columns).T) == [(3, 0), (3, 1)]
    assert crossings(np.array([[0, 10, 20], [5, 15, 25]]).T) == []


def test_exchanged_ids_are_not_kept_and_a_person_out_of_view_does_not_count():
    columns = [np.arange(20.0), np.arange(20.0)[::-1]]
    one, two = np.full(20, 1), np.full(20, 2)
    assert tally(paths_of(columns, [one, two])) >= Counter(crossings=2, kept=2, ids=2)
    half = np.arange(20) < 10
    swapped = tally(paths_of(columns, [np.where(half, one, two), np.where(half, two, one)]))
    assert swapped["crossings"] == 2 and swapped["kept"] == 0 and swapped["ids"] == 4
    gone = tally(paths_of(columns, [one, np.where(half, two, 0)], [half | True, half]))
    assert gone["crossings"] == gone["kept"] == 1


def test_a_return_keeps_the_id_or_not():
    seen = np.array([1] * 5 + [0] * 6 + [1] * 5)
    column = [np.arange(16.0)]
    assert tally(paths_of(column, [seen])) >= Counter(returns=1, again=1)
    other = tally(paths_of(column, [np.where(np.arange(16) < 8, seen, 3 * seen)]))
    assert other["returns"] == 1 and other["again"] == 0


def test_false_ids_are_flashes_or_phantoms():
    paths = paths_of([np.arange(4.0)], [np.ones(4, int)])
    paths.false_ids.update([7, 8, 8, 8])
    assert tally(paths) >= Counter(flashes=1, phantoms=1)


def test_walkers_move_and_are_the_same_again():
    first, later = (list(islice(walking_scenes(7, TRAINING), 4)) for _ in range(2))
    for one, same in zip(first, later, strict=True):
        np.testing.assert_array_equal(one.depth_mm, same.depth_mm)
    assert first[0].persons.any() and (first[0].persons != first[3].persons).any()
