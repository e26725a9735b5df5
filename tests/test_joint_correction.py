"""Correction of joints: mirror images and finer cameras give the same body, and hidden joints come nearer."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from annotate.crop import SIZE, Crop
from annotate.labelset.labelled_frames import camera_of, open_frames, pinhole_of
from annotate.posture import POSTURES
from annotate.scheme.regions import N_REGIONS, Region
from annotate.scheme.scheme_file import load_scheme
from eval.network.body_state import BodyState
from eval.network.joints import joint_correction
from eval.network.joints.joint_correction import TWIN_REGION, LocalJoints, corrected_joints
from eval.network.joints.region_places import has_regions, region_places
from eval.network.onnx_network import OnnxNetwork
from eval.scores.joint_errors import joint_visibility, true_joints_mm
from eval.scores.joints import N_JOINTS, TWIN
from sensors.rig.camera import Intrinsics
from synth.images.presets import preset_named, sample
from tests.helpers.shards import write_dataset
from tools.fit import joint_correction as fit

CAMERA = Intrinsics(512, 424, 366.0, 366.0, 255.5, 211.5)
RNG = np.random.default_rng(0)
PLACES = np.column_stack(
    [RNG.uniform(0, 90, N_REGIONS), RNG.uniform(200, 300, (N_REGIONS, 2)), RNG.uniform(1800, 2200, N_REGIONS)]
)
"""Pixels, columns, rows and depths."""


def some_state(camera=CAMERA) -> BodyState:
    """A person two metres away, with deviations of 10 to 200 mm."""
    rng = np.random.default_rng(3)
    posture = rng.dirichlet(np.ones(len(POSTURES))).astype(np.float32)
    sd = rng.uniform(10, 200, (N_JOINTS, 2)) * [camera.fx / 2000, 1]
    state = BodyState(
        30.0, 0.8, posture, np.zeros((N_JOINTS, 3)), "", sd, rng.dirichlet(np.ones(3), N_JOINTS)
    )
    return state.placed(rng.uniform(-400, 400, (N_JOINTS, 3)) + np.array([300, 100, 2000]), camera)


def mirror_image(state: BodyState) -> tuple[BodyState, np.ndarray]:
    """The same person and places of regions, seen in a mirror beside the camera."""
    twin = state.exchanged()
    joints_px = twin.joints_px.copy()
    joints_px[:, 0] = 2 * CAMERA.cx - joints_px[:, 0]
    places = PLACES[TWIN_REGION]
    places[:, 1] = 2 * CAMERA.cx - places[:, 1]
    return replace(twin, joints_px=joints_px, facing_deg=-state.facing_deg), places


def test_a_mirror_image_gets_the_mirrored_correction():
    state = some_state()
    own, other = (
        corrected_joints(one, CAMERA, places).joints_mm(CAMERA)
        for one, places in ((state, PLACES), mirror_image(state))
    )
    assert np.abs(own - state.joints_mm(CAMERA)).max() > 5
    np.testing.assert_allclose(other[TWIN] * [-1, 1, 1], own, atol=0.05)


def test_a_camera_with_more_pixels_gives_the_same_body():
    """Twice the columns, three times the rows; deviations across count columns."""
    fine = Intrinsics(1024, 1272, 732.0, 1098.0, 511.5, 635.5)
    own = corrected_joints(some_state(), CAMERA, PLACES)
    places = (PLACES + np.array([0, 0.5, 0.5, 0])) * [6, 2, 3, 1] - np.array([0, 0.5, 0.5, 0])
    other = corrected_joints(some_state(fine), fine, places)
    np.testing.assert_allclose(own.joints_mm(CAMERA), other.joints_mm(fine), atol=0.05)
    np.testing.assert_allclose(own.joints_sd_mm(CAMERA), other.joints_sd_mm(fine), rtol=1e-3)


class Constant:
    """A correction by one deviation to the right, two down, three away; deviations times 2 and 3."""

    def run(self, names, inputs):
        row = np.array([1.0, 2, 3, np.log(2), np.log(3)])
        return [np.stack([np.tile(row, (N_JOINTS, 1)), np.tile(row * [-1, 1, 1, 1, 1], (N_JOINTS, 1))])]


def test_an_output_counts_deviations(monkeypatch):
    monkeypatch.setattr(joint_correction, "shipped_joint_correction", Constant)
    state = some_state()
    found = corrected_joints(state, CAMERA, PLACES)
    across_px = state.joints_sd[:, 0]
    shifts = np.column_stack([across_px, 2 * across_px, 3 * state.joints_sd[:, 1]])
    np.testing.assert_allclose(found.joints_px - state.joints_px, shifts)
    np.testing.assert_allclose(found.joints_sd, state.joints_sd * [2, 3])


def test_joints_stay_in_front_of_the_camera(monkeypatch):
    near = some_state()
    near.joints_px[3, 2] = -5.0
    assert corrected_joints(near, CAMERA, PLACES) is near
    monkeypatch.setattr(Constant, "run", lambda *_: [np.full((2, N_JOINTS, 5), -50.0)])
    monkeypatch.setattr(joint_correction, "shipped_joint_correction", Constant)
    assert corrected_joints(some_state(), CAMERA, PLACES).joints_px[:, 2].min() == 1


def test_a_small_regions_place_is_no_input():
    few = PLACES.copy()
    few[:, 0] = 2  # pixels, 60 square millimetres
    first, second = (LocalJoints.of(some_state(), CAMERA, few * [1, k, 1, 1]).features() for k in (1, 2))
    np.testing.assert_array_equal(first, second)


def test_networks_of_other_schemes_keep_their_joints():
    named = {name: has_regions(load_scheme(name)) for name in ("atlas", "smpl-24", "paper", "hands-and-feet")}
    assert named == {"atlas": True, "smpl-24": True, "paper": False, "hands-and-feet": False}


def test_a_state_without_deviations_stays():
    bare = replace(some_state(), joints_sd=None, joints_seen=None)
    assert corrected_joints(bare, CAMERA, PLACES) is bare


def test_a_shift_leads_from_the_joints_to_the_true_ones():
    state, shifts_mm = some_state(), RNG.normal(0, 50, (N_JOINTS, 3))
    local = LocalJoints.of(state, CAMERA, PLACES)
    px_per_mm = CAMERA.fx / local.middle_mm
    there = replace(state, joints_px=state.joints_px + shifts_mm * [px_per_mm, px_per_mm, 1])
    examples = fit.Examples.of([(local, there.joints_mm(CAMERA), np.zeros(N_JOINTS, np.uint8))])
    placed = examples.placed(examples.joints + torch.tensor(shifts_mm, dtype=torch.float32))
    np.testing.assert_allclose(placed[0], there.joints_mm(CAMERA), atol=0.05)


def test_the_places_of_regions_are_those_of_their_pixels():
    """A naive twin: hard labels, pixel by pixel, in a crop as large as the network's."""
    atlas, mask = load_scheme("atlas"), np.zeros((SIZE, SIZE), np.bool_)
    mask[20:180, 30:200] = True
    depth_mm = np.where(mask, 1800 + np.arange(SIZE) % 50 * 4, 0).astype(np.uint16)
    labels = RNG.integers(0, 25, (SIZE, SIZE))
    planes = (labels == np.arange(25)[:, None, None]).astype(np.float32)
    crop, larger = Crop(7, 11, 2 * SIZE), (3 * SIZE, 3 * SIZE)
    whole = np.zeros(larger, np.uint16), np.zeros(larger, np.bool_)
    for image, values in zip(whole, (depth_mm, mask), strict=True):
        image[7 : 7 + crop.side, 11 : 11 + crop.side] = values.repeat(2, 0).repeat(2, 1)
    found = region_places(crop, whole, planes, atlas)
    for region in Region:
        rows, columns = np.nonzero(mask & (labels == atlas.class_table[region]))
        u, v, z = columns.mean(), rows.mean(), depth_mm[rows, columns].mean()
        expected = 4 * rows.size, 2 * u + 11.5, 2 * v + 7.5, z
        np.testing.assert_allclose(found[region - 1], expected, rtol=1e-4)


@pytest.mark.parametrize("preset", ["people", "recumbent"])
def test_joints_of_synthetic_people_come_nearer_to_the_truth(preset):
    network, errors = OnnxNetwork(), []
    for index in range(24):
        frame = sample(preset_named(preset), 44_700, index)
        camera = pinhole_of(frame, camera_of(None, frame))  # type: ignore[arg-type]
        image = frame.depth_mm, frame.on_person
        both = (BodyState.from_note(network.segment(*image, one).bearing) for one in (None, camera))
        errors.append([np.linalg.norm(s.joints_mm(camera) - true_joints_mm(frame), axis=1) for s in both])
    before, after = np.array(errors).mean(axis=(0, 2))
    assert after < 0.96 * before


def test_a_constant_error_is_learnt_and_its_deviation():
    rng, people = np.random.default_rng(1), []
    for _ in range(300):
        state = some_state().placed(rng.uniform(-400, 400, (N_JOINTS, 3)) + np.array([0, 0, 2000]), CAMERA)
        true_mm = state.joints_mm(CAMERA) + np.array([30.0, 0, 0]) + rng.normal(0, 5, (N_JOINTS, 3))
        people.append((LocalJoints.of(state, CAMERA, PLACES), true_mm, np.ones(N_JOINTS, np.uint8)))
    own = fit.Examples.of(people)
    out = fit.trained(own, own, 300, width=64)(own.features)
    shifts_mm = (out[..., :3] * own.deviations).detach().numpy()
    wide = own.deviations[..., 0].numpy() > 30  # shifts of narrow joints are bounded
    assert np.abs(np.median(shifts_mm[..., 0][wide]) - 30) < 6
    assert np.median(out[..., 3][torch.from_numpy(wide)].detach()) < -0.7


def test_stored_joints_are_those_of_the_network(tmp_path, monkeypatch):
    """Without cut people, so that the network sees the same pixels again."""
    monkeypatch.setattr(fit, "CUT", 0)
    frames = [sample(preset_named("people"), 44_701, index) for index in range(3)]
    data, network = write_dataset(tmp_path / "data", frames), OnnxNetwork()
    fit.store_joints(data.path, network, tmp_path / "joints.npz")
    own, mirrored = fit.examples_in([tmp_path / "joints.npz"])
    assert len(own.features) == len(mirrored.features) == 3
    for k, frame in enumerate(open_frames(data.path)):
        camera = pinhole_of(frame, camera_of(data, frame))
        state = BodyState.from_note(network.segment(frame.depth_mm, frame.on_person).bearing)
        placed = own.placed(own.joints)[k]
        np.testing.assert_allclose(placed, state.joints_mm(camera), atol=2)  # notes are rounded
        np.testing.assert_allclose(own.true[k], true_joints_mm(frame), atol=0.01)
        np.testing.assert_array_equal(own.visibility[k], joint_visibility(frame, camera_of(data, frame)))
        np.testing.assert_allclose(
            mirrored.true[k][TWIN] * torch.tensor([-1.0, 1, 1]), own.true[k], atol=0.01
        )
