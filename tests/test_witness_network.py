"""The network that corrects a witnessed person's parts: its input, its labels, its training examples."""

import pickle

import numpy as np
import pytest

from annotate.parts import PAPER
from annotate.scheme.scheme import UNDEFINED
from annotate.scheme.scheme_file import load_scheme
from annotate.segmentation.input_channels import CHANNELS, FIXED, LOG_LIKELIHOOD, SUBJECT, with_evidence
from annotate.witness.fusion import in_scheme
from annotate.witness.person_outline import person_outline
from eval.network.colour.witness_network import corrected, shipped_witness_network
from eval.network.colour.witnessed_body import witnessed_body
from eval.network.onnx_network import OnnxNetwork
from sensors.session.reader import Session
from synth.rig.truth import truth_labels
from tools.fit.witness_errors import NAMES, WitnessErrors
from tools.fit.witness_network import example_of, witnessed

ATLAS = load_scheme("atlas")
DOUBLED = WitnessErrors().doubled()


@pytest.fixture(scope="module")
def network() -> OnnxNetwork:
    return OnnxNetwork(flip=False)


@pytest.fixture(scope="module")
def people(rig_session):
    """True regions and pixels of the frames of a recording, and its camera."""
    depth = Session(rig_session).calibration.depth
    shot = pickle.loads(rig_session.with_suffix(".shot").read_bytes())
    frames = [truth_labels(frame, known, depth, ATLAS) for frame, known in shot]
    owns = [(one.persons == 1) & ATLAS.on_body(one.parts) & (one.depth_mm > 0) for one in frames]
    return list(zip(frames, owns, strict=True)), depth.undistorted()


def shown(frame, own, camera, seed):
    """The cloud and the outline of a frame's person by a witness with doubled errors."""
    cloud, person = witnessed(frame, (camera, DOUBLED, 2.0), np.random.default_rng(seed))
    outline = person_outline(cloud, person, NAMES, own)
    return cloud.cloud, outline, *outline.bounds()


def test_evidence_is_kept_to_a_byte_and_only_where_it_is_given():
    rng = np.random.default_rng(5)
    low, high = LOG_LIKELIHOOD
    planes = rng.integers(0, 255, (len(CHANNELS), 9, 7), np.uint8)
    rows = rng.uniform(low, high, (len(CHANNELS) - len(FIXED), 9, 7)).astype(np.float32)
    there = rng.random((9, 7)) < 0.5
    made = with_evidence(planes, rows, there)
    first = FIXED.index("skin")
    assert np.array_equal(made[:first], planes[:first])
    assert not made[first:, ~there].any()
    back = low + made[len(FIXED) :, there] * (high - low) / 255
    np.testing.assert_allclose(back, rows[:, there], atol=1.1 * (high - low) / 255)


def test_the_network_decides_parts_and_the_fusion_divides_them_among_regions(people, network):
    frames, camera = people
    cloud, outline, sure, wide = shown(*frames[0], camera, 1)
    body = witnessed_body(cloud, outline, wide, network)
    mask, found = corrected(cloud, body, sure, shipped_witness_network())
    np.testing.assert_allclose(found.sum(axis=0), 1, atol=1e-4)
    assert not (mask & ~wide).any()
    assert mask[sure & (cloud.depth_mm > 0)].all()
    regions = body.regions[:, mask[body.wide]]
    for part in PAPER.parts:
        own = [region - 1 for region in part.regions]
        before, after = (one[own] / one[own].sum(axis=0) for one in (regions, found))
        clear = regions[own].sum(axis=0) > 0.01
        np.testing.assert_allclose(after[:, clear], before[:, clear], atol=1e-2)


def test_the_network_is_right_where_depth_and_witness_err(people, network):
    frames, camera = people
    right, iou = np.zeros(3), np.zeros(2)
    for seed, (frame, own) in enumerate(frames):
        cloud, outline, sure, wide = shown(frame, own, camera, seed)
        body = witnessed_body(cloud, outline, outline.mask, network)
        known = np.where(own, PAPER.table[np.where(own, frame.parts, 0)], 0)
        within = (known > 0)[outline.mask]
        _, found = corrected(cloud, body, outline.mask, shipped_witness_network())
        by = (in_scheme(one, PAPER)[1:].argmax(axis=0) + 1 for one in (body.regions, found))
        each = [body.by_depth, *(PAPER.class_ids[one] for one in by)]
        right += [(one == known[outline.mask])[within].mean() / len(frames) for one in each]
        wider = witnessed_body(cloud, outline, wide, network)
        mask = corrected(cloud, wider, sure, shipped_witness_network()).mask
        iou += [(one & own).sum() / (one | own).sum() / len(frames) for one in (outline.mask, mask)]
    by_depth, by_fusion, by_network = right
    assert by_network > max(by_depth, by_fusion)
    assert iou[1] > iou[0]


def test_a_training_example_has_true_parts_everywhere_and_evidence_inside_the_outline(people, network):
    frames, camera = people
    frame, own = frames[0]
    example = example_of(frame, own, camera, network, np.random.default_rng(3))
    outside = (example.planes[0] & SUBJECT) == 0
    rows = example.planes[len(FIXED) :]
    assert (rows[:, outside] == 0).all()
    assert (rows[:, ~outside] > 0).all()
    body = np.isin(example.target, PAPER.body_classes)
    assert (rows.argmax(axis=0) + 1 == example.target)[body & ~outside].mean() > 0.7
    assert body.sum() == pytest.approx(own.sum(), rel=1e-2)
    assert set(np.unique(example.target)) <= {*range(len(PAPER.class_ids)), UNDEFINED}
    again = example_of(frame, own, camera, network, np.random.default_rng(3))
    assert all(np.array_equal(a, b) for a, b in zip(example, again, strict=True))
