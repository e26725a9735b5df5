"""Networks of any scheme: files name it, finer classes start from coarser ones, probabilities are summed."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from annotate.parts import PAPER  # noqa: E402
from annotate.scheme.merging import class_sums  # noqa: E402
from annotate.scheme.scheme_file import load_scheme  # noqa: E402
from eval.architecture.class_scores import class_probabilities, class_scores, merged_scores  # noqa: E402
from eval.architecture.compact import CompactConfig  # noqa: E402
from eval.architecture.kinds import Kinds  # noqa: E402
from eval.architecture.networks import build, scheme_of  # noqa: E402
from eval.architecture.reference_networks import PaperConfig  # noqa: E402
from eval.network.onnx_export import export_network  # noqa: E402
from eval.network.onnx_network import OnnxNetwork  # noqa: E402
from eval.network.weights_file import load_weights, save_weights  # noqa: E402
from eval.training.expansion import expanded  # noqa: E402
from sensors.errors import CloudError, FormatError  # noqa: E402
from tests.helpers.schemes import WARD  # noqa: E402

REGIONS, SIX, HANDS = load_scheme("atlas"), load_scheme("six"), load_scheme("hands-and-feet")
TINY = CompactConfig((4, 8, 8), 1)


def tiny(scheme, seed=0):
    torch.manual_seed(seed)
    network = build(TINY, scheme).eval()
    with torch.no_grad():
        for values in network.parameters():
            values.add_(0.2 * torch.randn_like(values))
    return network


def chances(network, images):
    with torch.no_grad():
        return torch.softmax(network(images).scores, dim=1).numpy()


@pytest.mark.parametrize(
    ("old", "new"),
    [(PAPER, HANDS), (PAPER, REGIONS), (SIX, PAPER), (SIX, REGIONS), (HANDS, WARD), (PAPER, WARD)],
    ids=lambda scheme: scheme.name,
)
def test_an_expanded_network_s_summed_probabilities_are_the_old_network_s(old, new):
    network, images = tiny(old), torch.rand(2, 1, 64, 64)
    finer = expanded(network, TINY, old, new).eval()
    summed = np.stack([class_sums(one, new, old) for one in chances(finer, images)])
    np.testing.assert_allclose(summed, chances(network, images), atol=1e-5)


def test_a_network_keeps_the_classes_that_a_coarser_scheme_joins():
    network = tiny(PAPER)
    assert expanded(network, TINY, PAPER, SIX) is network and scheme_of(network, SIX) == PAPER
    scores = torch.randn(2, len(PAPER.class_ids), 8, 8)
    merged = torch.softmax(merged_scores(scores, PAPER, SIX), 1).numpy()
    summed = np.stack([class_sums(one, PAPER, SIX) for one in torch.softmax(scores, 1).numpy()])
    np.testing.assert_allclose(merged, summed, atol=1e-6)


def test_a_network_without_a_bias_keeps_its_classes():
    config = PaperConfig(4, 8)
    with pytest.raises(CloudError, match="start without weights"):
        expanded(build(config), config, PAPER, HANDS)


@pytest.mark.parametrize("scheme", [PAPER, SIX, WARD, REGIONS], ids=lambda scheme: scheme.name)
def test_probabilities_from_kinds_and_side_are_the_softmax_of_the_scores(scheme):
    classes, generator = Kinds.of(scheme), torch.Generator().manual_seed(0)
    kinds = 10 * torch.randn(2, len(classes), 9, 9, generator=generator)
    side = 20 * torch.randn(2, 1, 9, 9, generator=generator) if any(classes.sides) else None
    seen = torch.rand(2, 1, 9, 9, generator=generator) < 0.7
    found = class_probabilities(classes, kinds, side, seen)
    expected = torch.softmax(class_scores(classes, kinds, side), dim=1)
    expected = torch.where(seen, expected, torch.eye(len(classes.of_class))[0][:, None, None])
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("scheme", [PAPER, SIX, WARD, REGIONS], ids=lambda scheme: scheme.name)
def test_weights_name_their_scheme_whole(tmp_path, scheme):
    network, path = tiny(scheme), tmp_path / "w.safetensors"
    save_weights(path, network, TINY, scheme)
    model, config, held = load_weights(path)
    assert (held, config) == (scheme, TINY)
    images = torch.rand(1, 1, 64, 64)
    np.testing.assert_array_equal(chances(model.eval(), images), chances(network, images))
    export_network(network, path.with_suffix(".onnx"), scheme=scheme)
    assert OnnxNetwork(path.with_suffix(".onnx")).scheme == scheme
    assert (b"left_upper_arm" in path.with_suffix(".onnx").read_bytes()) == (scheme != PAPER)


def test_a_network_s_labels_in_a_coarser_scheme_have_summed_probabilities(tmp_path):
    path, rng = tmp_path / "w.onnx", np.random.default_rng(0)
    export_network(tiny(REGIONS), path, scheme=REGIONS)
    network = OnnxNetwork(path)
    depth = rng.integers(1500, 2500, (212, 212)).astype(np.uint16)
    person = rng.random(depth.shape) < 0.7
    assert network.usual_scheme == PAPER and network.in_scheme(PAPER).usual_scheme == PAPER
    whole = network.segment(depth, person, probabilities=True).probabilities.planes
    for scheme in (PAPER, SIX, WARD):
        found = network.in_scheme(scheme).segment(depth, person, probabilities=True)
        planes = found.probabilities.planes
        summed = class_sums(whole, REGIONS, scheme)
        np.testing.assert_allclose(planes[scheme.class_ids], summed, atol=1e-6)
        assert found.scheme == scheme and planes.shape[0] == scheme.n_classes
        best = scheme.class_ids[1 + summed[1:].argmax(axis=0)]
        np.testing.assert_array_equal(found.parts, np.where(person, best, 0))
        np.testing.assert_allclose(found.confidence, np.where(person, summed[1:].max(axis=0), 0), atol=1e-6)


def test_a_file_without_a_scheme_is_of_the_given_one_where_the_number_of_classes_is_the_same(tmp_path):
    path = tmp_path / "own.onnx"
    export_network(tiny(SIX), path, scheme=SIX)
    unnamed = tmp_path / "unnamed.onnx"
    import onnx

    model = onnx.load(path)
    del model.metadata_props[:]
    onnx.save(model, unnamed)
    assert OnnxNetwork(unnamed, scheme=SIX).own == SIX
    with pytest.raises(
        FormatError, match=r"output \(2, 7, .* give a network of 12 classes .*name the scheme"
    ):
        OnnxNetwork(unnamed)
    with pytest.raises(FormatError, match=r"output \(2, 7, .* give a network of 16 classes"):
        OnnxNetwork(unnamed, scheme=HANDS)
    with pytest.raises(FormatError, match="several parts of scheme 'paper'"):
        OnnxNetwork(unnamed, scheme=SIX).in_scheme(PAPER)
    export_network(tiny(PAPER), path)
    assert OnnxNetwork(path, scheme=SIX).in_scheme(SIX).own == PAPER
