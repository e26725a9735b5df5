"""Training of the person finder: scenes and their people, augmentation, and the network's export."""

from itertools import islice

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from annotate.onnx_session import onnx_session
from annotate.person.detection.finder_network import FOCAL_PX
from eval.training.finder import stored
from eval.training.finder.images import (
    FIRST_THING,
    HEIGHT,
    WIDTH,
    SceneImages,
    _cut_out,
    _votes,
    _weights,
    draw_batch,
)
from eval.training.finder.network import (
    FinderNet,
    FinderTraining,
    TensorBatch,
    averaged_finder,
    export_finder,
    load_finder,
)
from eval.training.finder.stored import load_scenes, store_scenes
from eval.training.finder.warm import UNFELT, degraded_warmth, random_warmth
from eval.training.rooms import people as rooms_people
from eval.training.rooms.close_rooms import close_scenes
from eval.training.rooms.empty_rooms import empty_scenes
from eval.training.rooms.floor_plan import FloorPlan
from eval.training.rooms.gathering import gather
from eval.training.rooms.panes import wandering
from eval.training.rooms.scenes import room_scenes
from eval.training.rooms.soft import cloth, hung
from synth.body.crowd import crowd
from synth.cameras.random_sensor import KINDS
from synth.clothes.dress import naked
from synth.data_files import TRAINING
from synth.surface.furniture import Surface
from synth.surface.rasterize import box, merge


def test_rooms_are_the_same_for_a_seed_name_their_people_and_are_stored(tmp_path, monkeypatch):
    scenes, again = (list(room_scenes(3)) for _ in range(2))
    monkeypatch.setattr(stored, "room_scenes", lambda _: scenes)
    store_scenes(tmp_path, {"room": 1}, first=7)
    assert [path.name for path in tmp_path.iterdir()] == ["room_000007.npz"]
    stock = load_scenes(tmp_path)
    assert not stock.rig and not stock.close
    assert [set(np.unique(p[p < FIRST_THING])) for _, _, p in stock.rooms] == [
        set(np.unique(scene.persons)) for scene in scenes
    ]
    assert all(np.array_equal(a.depth_mm, b.depth_mm) for a, b in zip(scenes, again, strict=True))
    assert all((scene.depth_mm[scene.persons > 0] > 0).all() for scene in scenes)
    assert {int(scene.persons.max()) for scene in scenes} >= {0, 1}


def test_close_rooms_have_near_things_and_most_have_no_person():
    scenes = [scene for seed in (3, 4) for scene in close_scenes(seed)]
    # A camera that stands too near to read anything has no reading beyond 1 m either.
    near_mm = np.array([np.percentile(np.append(one.depth_mm[one.depth_mm > 0], 0), 5) for one in scenes])
    assert np.mean(near_mm < 1000) >= 0.8
    empty = [one for one in scenes if not one.whole_px]
    assert 0.4 <= len(empty) / len(scenes) <= 0.8 and len(scenes) - len(empty) >= 2
    assert not any(one.persons.any() for one in empty)
    assert any(one.persons.any() for one in scenes)
    assert all(one.things[one.persons > 0].max(initial=0) == 0 for one in scenes)
    assert sum(one.things.any() for one in scenes) >= 0.8 * len(scenes)


def test_no_cushion_lies_on_a_sofa_of_two_people(monkeypatch):
    monkeypatch.setattr(rooms_people, "sit", lambda body, *_: (body.vertices_m, body.joints_m))
    people = [naked(body) for body in crowd()[:2]]
    seated = [rooms_people._seated(people, 0, TRAINING, np.random.default_rng(seed)) for seed in range(120)]
    alone, pairs = (
        merge([mesh for one in seated if len(one.people) == count for mesh in one.things]).tags
        for count in (1, 2)
    )
    assert Surface.PILLOW in alone and len(pairs) and Surface.PILLOW not in pairs


def test_empty_rooms_have_nobody_and_all_sensors():
    scenes = [scene for seed in (1, 2) for scene in empty_scenes(seed)]
    assert not any(scene.persons.any() or scene.whole_px for scene in scenes)
    assert len({scene.sensor for scene in scenes}) >= len(KINDS) - 1
    again = next(empty_scenes(1))
    assert np.array_equal(again.depth_mm, scenes[0].depth_mm)


def test_a_cloth_lies_on_its_place_and_hangs_before_its_plane():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        lying, hanging = cloth(rng, np.array([1.0, 2.0, 0.5])), hung(rng, np.array([1.0, 2.0, 1.0]))
        low, high = lying.vertices_m.min(axis=0), lying.vertices_m.max(axis=0)
        assert low[2] == pytest.approx(0.5, abs=1e-5) and 0.51 < high[2] < 1.1
        assert np.allclose((low + high)[:2] / 2, (1, 2), atol=1e-4) and (high - low)[:2].max() < 2.1
        assert np.ptp(hanging.vertices_m[:, 2]) > np.ptp(hanging.vertices_m[:, 1]) * 0.5
        assert hanging.vertices_m[:, 1].mean() < 2


def test_a_small_persons_pixels_weigh_more_and_missing_ones_nothing():
    persons = np.zeros((HEIGHT, WIDTH), np.uint8)
    persons[:20, :10], persons[50:150, 50:100] = 1, 2
    depth = np.full(persons.shape, 2.0, np.float32)
    depth[-5:] = 0
    weights = _weights(depth, persons)
    assert weights[0, 0] > weights[100, 70] > weights[180, 200] == 1 and not weights[-5:].any()


def test_things_are_cut_out_without_people():
    whose = np.zeros((HEIGHT, WIDTH), np.uint8)
    whose[40:150, 80:130], whose[60:150, 130:190], whose[:5, :5] = 1, FIRST_THING + 3, FIRST_THING
    things, people = 0, 0
    for seed in range(40):
        kept = _cut_out(whose, np.random.default_rng(seed))
        assert not kept[:40, :70].any() and 0.2 * whose.size > kept.sum() > 4000
        shown = kept[whose == 1].mean()
        assert shown == 0 or shown > 0.85
        things, people = things + (shown == 0), people + (shown > 0)
    assert things > 10 and people > 10
    whose[whose == 1] = 0
    assert _cut_out(whose, np.random.default_rng(0))[80:140, 140:180].all()
    assert _cut_out(np.zeros_like(whose), np.random.default_rng(0)).all()


def test_a_batch_depends_on_its_step_alone_also_with_worker_processes():
    whose = np.zeros((212, 256), np.uint8)
    whose[40:160, 80:130] = 1
    image = (np.where(whose > 0, np.uint16(2000), np.uint16(3000)), whose.astype(np.float16), whose)
    images = SceneImages([image], [], [image])
    cv2.GaussianBlur(np.zeros((2000, 2000), np.float32), (0, 0), 5)  # starts OpenCV's threads: workers hung
    alone = list(islice(FinderTraining(images, 1).batches(0), 4))[2:]
    with_workers = list(islice(FinderTraining(images, 1, workers=2).batches(2), 2))
    for one, other in zip(alone, with_workers, strict=True):
        assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True))
    assert not torch.equal(alone[0].inputs, alone[1].inputs)


def test_a_place_is_taken_once():
    plan, cube = FloorPlan(), box((0, 0, 0), (1, 1, 1), 0)
    for x, y, free in ((0, 0, True), (0.5, 0.5, False), (1.1, 0, True), (-1.1, 0.5, True), (30, 0, False)):
        assert plan.take([cube.placed(np.eye(3), np.array([x, y, 0]))]) == free


def test_people_stand_beside_each_other_but_not_in_each_other():
    rng, people = np.random.default_rng(5), [naked(body) for body in crowd()[:6]]
    placed = [mesh for one in gather(rng, people, FloorPlan(), 0.5, TRAINING) for mesh in one.people]
    trees = [cKDTree(mesh.vertices_m) for mesh in placed]
    apart = [
        one.query(mesh.vertices_m, distance_upper_bound=0.3)[0].min()
        for i, one in enumerate(trees)
        for mesh in placed[:i]
    ]
    assert len(placed) >= 4 and 0.005 < min(apart) < 0.3


def test_depth_wanders_only_where_a_pane_is_in_front():
    rng, behind = np.random.default_rng(0), np.full((60, 80), 3, np.float32)
    pane = np.full((60, 80), np.nan, np.float32)
    pane[:, 20:40], pane[:, 60:] = 2, 4
    depth, shown = wandering(behind, pane, rng)
    assert (depth == behind)[~(pane < behind)].all() and shown[~(pane < behind)].all()
    other = depth[:, 20:40][~shown[:, 20:40]]
    assert len(other) > 100 and np.nanmax(other) > 2.2 and not (other < 1.5).any()
    assert (depth[shown] == 3).all()


def test_people_in_an_invented_warmth_are_warm_and_what_is_spoilt_was_felt():
    persons = np.zeros((HEIGHT, WIDTH), np.uint8)
    persons[40:150, 80:130] = 1
    depth_mm = np.where(persons > 0, np.uint16(2000), np.uint16(3000))
    unfelt = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        warmth = random_warmth(depth_mm, persons, rng)
        hidden = np.isnan(warmth)
        assert hidden.mean() < 0.1 and not hidden[persons > 0].any()
        assert np.nanmean(warmth[persons > 0]) > np.nanmedian(warmth[persons == 0]) + 0.25
        worn = degraded_warmth(warmth, rng)
        assert worn.shape == warmth.shape and worn.dtype == np.float32
        unfelt += not np.isfinite(worn).any()
    assert 0.3 * UNFELT < unfelt / 60 < 2 * UNFELT


def test_votes_of_a_person_meet_in_their_middle():
    depth = np.full((HEIGHT, WIDTH), 3.0, np.float32)
    persons = np.zeros((HEIGHT, WIDTH), np.uint8)
    persons[40:90, 60:80] = 1
    depth[persons > 0] = np.linspace(1.9, 2.1, 50)[:, None].repeat(20, 1).ravel()
    right, down, away = _votes(depth, persons)
    focal_px = FOCAL_PX / 2  # votes are of every second pixel
    v, u = np.nonzero(persons)
    z = depth[v, u]
    assert np.allclose(u + right[v, u] / z * focal_px, u.mean(), atol=0.1)
    assert np.allclose(v + down[v, u] / z * focal_px, v.mean(), atol=0.1)
    assert np.allclose(z + away[v, u], 2.0, atol=0.01)
    assert not right[persons == 0].any()


def test_a_step_learns_and_the_exported_network_answers_as_the_trained_one(tmp_path):
    persons = np.zeros((212, 256), np.uint8)
    cv2.ellipse(persons, (120, 100), (30, 70), 0, 0, 360, 1, -1)
    depth_mm = np.where(persons > 0, np.uint16(2000), np.uint16(3000))
    images = [(depth_mm, persons.astype(np.float16), persons)]
    drawn = draw_batch(SceneImages(images, []), 4, np.random.default_rng(0))
    batch = TensorBatch(*map(torch.from_numpy, drawn))
    torch.manual_seed(0)
    network = FinderNet().train()
    optimizer = torch.optim.AdamW(network.parameters(), 3e-3)
    losses, training = [], FinderTraining(SceneImages(images, []), 1)
    for _ in range(4):
        loss, _ = training.loss(network, batch, 0)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.9 * losses[0]
    export_finder(network, tmp_path / "x.onnx")
    read, again = onnx_session((tmp_path / "x.onnx").read_bytes()), load_finder(tmp_path / "x.onnx").eval()
    for shape in ((32, 64), (96, 128)):
        image = np.random.default_rng(1).normal(size=(1, 24, *shape)).astype(np.float32)
        with torch.no_grad():
            trained = network(torch.from_numpy(image))
            # Weights are stored in half precision.
            assert np.allclose(read.run(None, {"image": image})[0], trained, atol=0.05)
            assert np.allclose(again(torch.from_numpy(image)), trained, atol=0.05)


def test_averaged_weights_lie_between_the_new_and_the_old_ones(tmp_path):
    new, old = (tmp_path / name for name in ("new.onnx", "old.onnx"))
    for seed, path in enumerate((new, old)):
        torch.manual_seed(seed)
        network = FinderNet()
        for tensor in network.state_dict().values():
            # Equal tensors would be written once.
            tensor.copy_(torch.rand(tensor.shape) + 0.5)
        export_finder(network, path)
    ends = [load_finder(path).state_dict() for path in (new, old)]
    for share in (0.0, 0.25, 1.0):
        mixed = averaged_finder(new, old, share).state_dict()
        for name in ("fine.0.weight", "head.bias", "down.0.0.1.running_var"):
            assert torch.allclose(mixed[name], share * ends[0][name] + (1 - share) * ends[1][name], atol=1e-6)
