"""Second stage of person detection: crops at one metric size, and its training."""

import numpy as np
import pytest
import torch

from annotate.onnx_session import onnx_session
from annotate.person.detection.finder_network import FOCAL_PX
from annotate.person.detection.verifier import INPUTS, SIDE, SIDE_M, crop_input
from eval.training.finder.images import FIRST_THING, STORED_FOCAL_PX
from eval.training.finder.verification import (
    Examples,
    VerifierNet,
    VerifierTraining,
    augmented,
    export_verifier,
)
from eval.training.finder.verification_examples import candidates_in_depth, examples_of, is_person, truths
from sensors.rig.camera import Intrinsics
from tests.helpers.furnished_room import seen


def view(focal_px):
    """Return depth (h, w) in metres of a standing person in a room, and person numbers (h, w)."""
    width, height = round(1.4 * focal_px), round(1.15 * focal_px)
    camera = Intrinsics(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)
    depth_m, persons = seen([(1, 0.0)], camera=camera)
    return np.nan_to_num(depth_m).astype(np.float32), persons


def crop_at(distance_m, height=288, width=384):
    """A board of 0.4 x 1.2 m before a wall 1 m behind it, and the crop of the board."""
    v, u = np.mgrid[:height, :width]
    x, y = ((at - (n - 1) / 2) * distance_m / FOCAL_PX for at, n in ((u, width), (v, height)))
    board = (np.abs(x) < 0.2) & (np.abs(y) < 0.6)
    depth = np.where(board, distance_m, distance_m + 1).astype(np.float32)
    odds = np.where(board, 6, -6).astype(np.float32)
    return crop_input(depth, odds, board, (FOCAL_PX, FOCAL_PX))


def test_a_crop_has_the_same_size_in_metres_at_any_distance():
    near, far = crop_at(2.5), crop_at(4.0)
    assert near.shape == (INPUTS, SIDE, SIDE) and np.abs(near).max() <= 2
    covered = near[5].sum() * (SIDE_M / SIDE) ** 2
    assert covered == pytest.approx(0.4 * 1.2, rel=0.1)
    assert far[5].sum() == pytest.approx(near[5].sum(), rel=0.1)
    inside = (near[0] > 0) & (far[0] > 0)
    assert (np.abs(near - far)[2:, inside] < 0.1).mean() > 0.93


def test_beyond_the_image_a_crop_is_empty_and_marked():
    crop = crop_at(1.0)
    assert 0.2 < crop[0].mean() < 0.8 and not crop[1:, crop[0] == 0].any()


def test_a_candidate_is_a_person_if_half_of_it_is_one_person():
    persons = np.zeros((10, 100), np.uint8)
    persons[:, :30], persons[:, 30:60] = 1, 2
    for end, truth in ((30, True), (65, None), (100, None)):
        mask = np.zeros(persons.shape, np.bool_)
        mask[:, :end] = True
        assert is_person(mask, persons) is truth
    mask[:, :55] = False
    assert is_person(mask, persons) is False


def test_of_two_candidates_on_a_person_the_larger_one_is_the_person():
    persons = np.zeros((10, 100), np.uint8)
    persons[:, :30], persons[:, 30:60] = 1, 2
    spans = ((0, 20), (20, 30), (30, 58), (60, 90))
    masks = [np.isin(np.arange(1000) % 100, np.arange(*span)).reshape(10, 100) for span in spans]
    assert truths(masks, persons) == [True, False, True, False]
    assert truths([], persons) == []


def test_examples_are_the_candidates_of_images_with_the_truth():
    depth_m, persons = view(FOCAL_PX)
    shown = [is_person(mask, persons) for mask in candidates_in_depth(depth_m).masks().values()]
    assert True in shown
    depth_m, persons = view(STORED_FOCAL_PX)
    depth_mm, unfelt = (1000 * depth_m).astype(np.uint16), np.full(depth_m.shape, np.nan, np.float16)
    things = np.where(persons > 0, np.uint8(FIRST_THING), np.uint8(0))
    for surfaces, least in ((persons, 0.4), (things, 0.0)):
        found = examples_of([(depth_mm, unfelt, surfaces)] * 12, np.random.default_rng(0))
        assert found.crops.shape[1:] == (INPUTS, SIDE, SIDE) and len(found.crops) == len(found.is_person) > 4
        assert found.is_person.mean() >= least
    assert not found.is_person.any()


def test_the_verifier_learns_and_its_file_gives_the_same(tmp_path):
    rng = np.random.default_rng(0)
    crops = rng.normal(0, 0.3, (200, INPUTS, SIDE, SIDE)).astype(np.float16)
    is_person = (np.arange(200) % 2).astype(np.float32)
    crops[is_person > 0, 2, 20:60, 30:50] += 1
    training = VerifierTraining(Examples(crops, is_person), 1)
    torch.manual_seed(0)
    network, losses = VerifierNet().train(), []
    optimizer = torch.optim.AdamW(network.parameters(), 3e-3)
    for _, batch in zip(range(8), training.batches(0), strict=False):
        loss, _ = training.loss(network, batch, 0)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.5 * losses[0]
    export_verifier(network, tmp_path / "x.onnx")
    few = crops[:5].astype(np.float32)
    found = onnx_session((tmp_path / "x.onnx").read_bytes()).run(None, {"crop": few})[0]
    with torch.no_grad():
        assert np.allclose(found, network(torch.from_numpy(few)), atol=0.05)


def test_augmented_crops_are_the_same_ones_moved():
    crops = np.zeros((40, INPUTS, SIDE, SIDE), np.float32)
    crops[:, 1:, 30:40, 25:45] = 1
    moved = augmented(crops, np.random.default_rng(1))
    assert (moved[:, 1].sum((1, 2)) == 200).all()
    assert len(np.unique(moved[:, 1].argmax(axis=1).max(axis=1))) > 4
    assert 0 < (moved[:, -1].sum((1, 2)) == 0).mean() < 0.3
