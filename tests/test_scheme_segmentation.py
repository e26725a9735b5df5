"""Segmentation networks of any scheme: started from the paper's, their inputs and their labels."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from annotate.parts import PAPER  # noqa: E402
from annotate.scheme.merging import class_sums  # noqa: E402
from annotate.scheme.scheme import Part, scheme_of  # noqa: E402
from annotate.scheme.scheme_file import load_scheme  # noqa: E402
from annotate.segmentation.input_channels import FIXED, channel_names, network_input  # noqa: E402
from annotate.segmentation.segment import parts_of  # noqa: E402
from annotate.segmentation.suit_network import (  # noqa: E402
    SuitNetwork,
    flipped,
    other_person,
    swap_classes,
)
from annotate.suit.color_model import unfitted  # noqa: E402
from annotate.suit.palette import DEFAULT_SUIT  # noqa: E402
from eval.training.segmentation.augmentation import Sampling, draw_sample  # noqa: E402
from eval.training.segmentation.examples import Example  # noqa: E402
from eval.training.segmentation.network import (  # noqa: E402
    FULL_SUIT_NETWORK,
    expanded_suit_network,
    export_suit_network,
    inputs_of,
    load_suit_network,
)
from tests.helpers.schemes import WARD  # noqa: E402
from tests.test_scheme_networks import REGIONS  # noqa: E402

HANDS, SIX = load_scheme("hands-and-feet"), load_scheme("six")
CHAIR = scheme_of("chair", [*PAPER.parts, Part(12, "wheelchair", "Wheelchair", (9, 200, 9))])


def planes_of(scheme, seed=0, shape=(32, 48)):
    """Random channels of a scheme, with each class in ``before``."""
    rng = np.random.default_rng(seed)
    planes = rng.integers(0, 256, (len(channel_names(scheme)), *shape)).astype(np.uint8)
    planes[FIXED.index("before")] = rng.integers(0, len(scheme.class_ids), shape)
    return planes


def coarser(planes, scheme):
    """The same channels in the paper's scheme; children have the likelihood of their first region."""
    made = np.zeros((len(channel_names(PAPER)), *planes.shape[1:]), np.uint8)
    made[: len(FIXED)] = planes[: len(FIXED)]
    ids = scheme.class_ids[planes[FIXED.index("before")]]
    table = np.zeros(256, np.uint8)
    for part in scheme.parts:
        table[part.id] = PAPER.ids_of(part.regions)[0] if part.regions else 0
    made[FIXED.index("before")] = table[ids]
    body = [part for part in scheme.parts if part.regions]
    for row, part in enumerate(PAPER.parts):
        mine = [i for i, one in enumerate(body) if one.regions <= part.regions]
        for i in mine:
            planes[len(FIXED) + i] = planes[len(FIXED) + mine[0]]
        made[len(FIXED) + row] = planes[len(FIXED) + mine[0]]
    return made


@pytest.fixture(scope="module")
def shipped():
    return load_suit_network(FULL_SUIT_NETWORK)


@pytest.mark.parametrize("scheme", [HANDS, REGIONS, CHAIR, WARD], ids=lambda scheme: scheme.name)
def test_an_expanded_network_gives_the_paper_s_probabilities_for_the_same_image(shipped, scheme):
    planes = planes_of(scheme)
    paper = coarser(planes, scheme)
    network = expanded_suit_network(shipped, scheme).eval()
    assert network.scheme == scheme
    with torch.no_grad():
        finer = torch.from_numpy(network_input(planes, len(scheme.parts))[None])
        found = torch.softmax(network(finer)[0], 0).numpy()
        coarse = torch.from_numpy(network_input(paper, len(PAPER.parts))[None])
        expected = torch.softmax(shipped(coarse)[0], 0).numpy()
    np.testing.assert_allclose(class_sums(found, scheme, PAPER), expected, atol=1e-5)


def test_a_network_of_regions_runs_and_trains_on_from_its_file(tmp_path, shipped):
    path = tmp_path / "regions.onnx"
    export_suit_network(expanded_suit_network(shipped, REGIONS), path)
    again, network = load_suit_network(path), SuitNetwork(path)
    assert again.scheme == network.own == REGIONS
    planes = planes_of(REGIONS)
    found = network.probabilities(planes, 1)
    assert found.shape == (other_person(REGIONS) + 1, 32, 48)
    with torch.no_grad():
        given = torch.from_numpy(network_input(planes, len(REGIONS.parts))[None])
        np.testing.assert_allclose(found, torch.softmax(again(given)[0], 0).numpy(), atol=1e-4)
    summed = network.in_scheme(PAPER)
    np.testing.assert_allclose(summed.probabilities(planes, 1), class_sums(found, REGIONS, PAPER), atol=1e-6)
    assert network.scheme == REGIONS and summed.own == REGIONS


@pytest.mark.parametrize("scheme", [PAPER, SIX, WARD, REGIONS], ids=lambda scheme: scheme.name)
def test_a_flip_twice_is_the_image(scheme):
    planes = planes_of(scheme)
    np.testing.assert_array_equal(flipped(flipped(planes, scheme), scheme), planes)
    classes = np.arange(256, dtype=np.uint8)
    swapped = swap_classes(classes, scheme)
    kept = other_person(scheme)
    np.testing.assert_array_equal(swapped[kept:], classes[kept:])
    np.testing.assert_array_equal(scheme.class_ids[swapped[:kept]], scheme.twin_table[scheme.class_ids])
    names = channel_names(scheme)[len(FIXED) :]
    twins = {part.name: part.id for part in scheme.parts}
    for row, name in enumerate(names):
        twin = int(scheme.twin_table[twins[name]])
        at = names.index(next(part.name for part in scheme.parts if part.id == twin))
        np.testing.assert_array_equal(
            flipped(planes, scheme)[len(FIXED) + row], planes[len(FIXED) + at][:, ::-1]
        )


@pytest.mark.parametrize("scheme", [SIX, WARD, REGIONS], ids=lambda scheme: scheme.name)
def test_samples_hold_classes_of_their_scheme_alone(scheme):
    rng, planes = np.random.default_rng(1), planes_of(scheme, shape=(80, 80))
    target = rng.integers(0, other_person(scheme) + 1, (80, 80)).astype(np.uint8)
    example = Example(planes, target, np.array([365.0, 2.0]))
    for seed in range(20):
        rng = np.random.default_rng(seed)
        drawn = draw_sample(example, Sampling(0.012, 32, by_part=seed % 2 == 0), rng, scheme)
        assert set(np.unique(drawn.target)) <= {*range(other_person(scheme) + 1), 255}
        assert drawn.planes[FIXED.index("before")].max() < other_person(scheme)
        assert network_input(drawn.planes, len(scheme.parts)).shape[0] == inputs_of(scheme)


def test_classes_are_the_parts_by_id_and_another_person_is_background():
    for scheme in (PAPER, SIX, HANDS, WARD, REGIONS):
        named = np.arange(other_person(scheme) + 1, dtype=np.uint8)
        assert parts_of(named, scheme).tolist() == [*scheme.class_ids.tolist(), 0]


def test_a_part_s_likelihood_is_the_greatest_of_its_parts_in_a_finer_scheme():
    model, rng = unfitted(DEFAULT_SUIT), np.random.default_rng(4)
    rgb = rng.integers(30, 240, (200, 3)).astype(np.uint8)
    regions = model.evidence(rgb, REGIONS)
    for scheme in (PAPER, SIX, HANDS, WARD):
        body = [part for part in scheme.parts if part.regions]
        for likely, part in zip(model.evidence(rgb, scheme), body, strict=True):
            rows = [region - 1 for region in part.regions]
            np.testing.assert_array_equal(likely, regions[rows].max(axis=0))
