"""The second look: its network, what it goes by, and that it mends labels."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.cloud.fuse import Fuser
from annotate.engine import Engine, shipped_weights
from annotate.frame_labels import FrameLabels
from annotate.labelset.store import LabelSet
from annotate.parts import UNDEFINED
from annotate.person.extract import Survey
from annotate.second_look.descriptors import (
    DESCRIPTOR_WIDTH,
    NEAREST_SUPERVOXELS,
    descriptors,
    neighbour_pairs,
)
from annotate.second_look.look import look_again
from annotate.second_look.network import GraphNetwork
from annotate.segmentation.segment import segment
from annotate.suit.palette import load_suit
from eval.training.engine_data import Rows
from eval.training.engine_graph import Graph, Joined
from sensors.session.reader import Session
from synth.rig.simulate import suit_path, truth_path

SHIPPED = GraphNetwork(**shipped_weights().network)


def drawn(seed: int, count: int) -> Rows:
    rng = np.random.default_rng(seed)
    pairs = np.unique(np.sort(rng.integers(0, count, (3 * count, 2)), axis=1), axis=0)
    patch = np.unique(rng.integers(0, max(count // 5, 1), count), return_inverse=True)[1]
    found = rng.standard_normal((count, DESCRIPTOR_WIDTH)).astype(np.float32)
    pixels = rng.integers(0, 20, (count, 13)).astype(np.int32) + 1
    return Rows(found, pairs[pairs[:, 0] < pairs[:, 1]].astype(np.int32), patch, pixels)


def asked(network: GraphNetwork, rows: Rows) -> np.ndarray:
    return network(rows.described.astype(np.float64), rows.edges, rows.patch, rows.pixels.sum(axis=1))


seeds = st.tuples(st.integers(0, 2**32 - 1), st.integers(1, 60))


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_the_network_says_what_it_was_trained_to_say(drawing):
    rows = drawn(*drawing)
    torch.manual_seed(drawing[0])
    trained = Graph(DESCRIPTOR_WIDTH).eval()
    middle, spread = np.zeros(DESCRIPTOR_WIDTH, np.float32), np.ones(DESCRIPTOR_WIDTH, np.float32)
    chance = asked(GraphNetwork(middle, spread, **trained.arrays()), rows)
    with torch.no_grad():
        expected = torch.softmax(trained(torch.tensor(rows.described), Joined([rows])), 1)
    np.testing.assert_allclose(chance, expected, atol=1e-5)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_no_order_of_supervoxels_matters(drawing):
    rows = drawn(*drawing)
    order = np.random.default_rng(1).permutation(len(rows.patch))
    place = np.argsort(order)
    shuffled = Rows(rows.described[order], place[rows.edges], rows.patch[order], rows.pixels[order])
    np.testing.assert_allclose(asked(SHIPPED, shuffled), asked(SHIPPED, rows)[order], atol=1e-4)


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_a_mirror_of_a_mirror_shows_the_frame(drawing):
    rows, twice = drawn(*drawing), drawn(*drawing).mirrored().mirrored()
    for name in ("described", "edges", "patch", "pixels"):
        np.testing.assert_array_equal(getattr(twice, name), getattr(rows, name))
    assert (rows.mirrored().described != rows.described).any()


@given(st.integers(1, 80), st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_neighbours_are_the_nearest_ones(count, seed):
    places = np.random.default_rng(seed).uniform(0, 0.4, (count, 3)).astype(np.float32)
    away = np.linalg.norm(places[:, None] - places[None], axis=2)
    expected = set()
    for i in range(count):
        for j in np.argsort(away[i], kind="stable")[1 : NEAREST_SUPERVOXELS + 1]:
            if away[i, j] < 0.15:
                expected.add((min(i, j), max(i, j)))
    assert {tuple(pair) for pair in neighbour_pairs(places.astype(np.float64)).tolist()} == expected


def test_the_shipped_weights_fit_what_is_described():
    network = SHIPPED
    assert network.middle.shape == network.spread.shape == (DESCRIPTOR_WIDTH,)
    assert all(np.isfinite(getattr(network, name)).all() for name in vars(network))


@pytest.fixture(scope="module")
def frame(rig_session):
    session, truth = Session(rig_session), LabelSet.open(truth_path(rig_session))
    cloud = Fuser(session.calibration).fuse_frame(session.frame(1))
    return cloud, load_suit(suit_path(rig_session)), truth.read("000001").parts


def test_a_second_look_mends_labels_and_keeps_within_what_is_measured(frame):
    cloud, suit, truth = frame
    person = Survey(cloud, None, suit).person(None)
    first = segment(cloud, person.mask, suit)
    spoilt = replace(first, parts=np.where(first.parts == 7, 2, first.parts).astype(np.uint8))
    labels, again = look_again(cloud, person, spoilt, None, Engine())
    known = truth != UNDEFINED
    assert (labels.parts == truth)[known & (truth == 7)].mean() > 0.5
    assert (labels.parts == truth)[known].mean() >= (first.parts == truth)[known].mean() - 0.002
    assert not (again.mask & ~cloud.valid).any() and not (again.mask & again.others).any()
    assert ((labels.parts > 0) == again.mask).all() and ((labels.confidence > 0) <= again.mask).all()
    twice, _ = look_again(cloud, person, spoilt, None, Engine())
    assert np.array_equal(twice.parts, labels.parts)


def test_without_a_suit_or_temperatures_there_is_no_second_look(frame):
    cloud, suit, _ = frame
    person = Survey(cloud, None, suit).person(None)
    first = segment(cloud, person.mask, suit)
    unfelt = replace(cloud, temperature_c=np.full_like(cloud.temperature_c, np.nan))
    for one in (Survey(cloud).person(None), Survey(unfelt, None, suit).person(None)):
        labels, again = look_again(cloud, one, first, None, Engine())
        assert labels is first and again is one


def test_every_number_described_is_finite_whatever_is_missing(frame):
    cloud, suit, _ = frame
    person = Survey(cloud, None, suit).person(None)
    first = segment(cloud, person.mask, suit)
    here = FrameLabels("x", cloud.depth_mm, first.parts, first.confidence)
    other = FrameLabels("x", *(image[:9, :9] for image in (cloud.depth_mm, first.parts, first.confidence)))
    for before in (None, other, here):
        rows = descriptors(cloud, person.mask, person.candidates, first, before)
        assert rows.shape[1] == DESCRIPTOR_WIDTH and np.isfinite(rows).all()
