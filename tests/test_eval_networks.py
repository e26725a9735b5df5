"""Networks keep the image's size, configurations survive as JSON, the paper's has the paper's size."""

import json
import warnings
from itertools import pairwise

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from annotate.crop import SIZE  # noqa: E402
from annotate.parts import N_CLASSES  # noqa: E402
from eval.architecture.compact import CompactConfig  # noqa: E402
from eval.architecture.networks import build, config_from, described  # noqa: E402
from eval.architecture.reference_networks import PaperConfig, PaperFcn, SmpConfig, _bilinear  # noqa: E402
from sensors.errors import CloudError, FormatError  # noqa: E402

CONFIGS = (CompactConfig((4, 6, 8)), PaperConfig(2, 4), SmpConfig(decoder=(16, 8, 8, 4, 4)))


@pytest.mark.parametrize("config", CONFIGS, ids=lambda c: type(c).__name__)
def test_a_configuration_survives_as_json(config):
    assert config_from(json.loads(json.dumps(described(config)))) == config


@pytest.mark.parametrize(
    "description",
    [
        {},
        [],
        "compact",
        {"kind": "compact"},
        {"kind": "other", "widths": [4]},
        {"kind": "compact", "widths": 4, "layers": 1},
        {"kind": "compact", "widths": [4, 0], "layers": 1},
        {"kind": "compact", "widths": [4, True], "layers": 1},
        {"kind": "compact", "widths": [4], "layers": 1, "code": "1"},
        {"kind": "paper", "base": 0, "dense": 4},
        {"kind": "paper", "base": 2.5, "dense": 4},
        {"kind": "smp", "encoder": 1, "decoder": [4]},
        {"kind": "smp", "encoder": "tu-hf_hub:somebody/theirs", "decoder": [4]},
        {"kind": "smp", "encoder": "hf-hub/theirs", "decoder": [4]},
        {"kind": "smp", "encoder": "resnet18", "decoder": []},
        {"kind": "compact", "widths": [], "layers": 1},
        {"kind": "compact", "widths": {"4": 4, "layers": 1}},
    ],
)
def test_what_describes_no_network_is_refused(description):
    with pytest.raises(FormatError):
        config_from(description)


@pytest.mark.parametrize(
    ("config", "side"),
    [(c, s) for c in CONFIGS[:2] for s in (32, SIZE)] + [(CONFIGS[0], 2), (CONFIGS[0], 30)],
)
def test_networks_keep_the_images_size(config, side):
    with torch.no_grad():
        scores = build(config).eval()(torch.rand(2, 1, side, side)).scores
    assert scores.shape == (2, N_CLASSES, side, side)


def test_the_papers_network_has_the_papers_layers():
    """Fifteen convolutions, five deconvolutions, four skips; 135.1 M parameters at full width."""
    network = PaperFcn(PaperConfig(4, 16))
    layers = list(network.modules())
    convolutions = [m for m in layers if isinstance(m, torch.nn.Conv2d) and m.out_channels != N_CLASSES]
    assert len(convolutions) == 15
    assert sum(isinstance(m, torch.nn.ConvTranspose2d) for m in layers) == 5
    assert len(network.skips) == 4
    assert sum(p.numel() for p in network.parameters()) == parameters(4, 16)
    assert parameters(64, 4096) / 1e6 == pytest.approx(135.1, abs=0.05)


def parameters(base: int, dense: int) -> int:
    """By hand: weights, and two numbers a channel for its normalisation; scores have a bias instead."""
    vgg = [base * k for k in (1, 1, 2, 2, 4, 4, 4, 8, 8, 8, 8, 8, 8)]
    convolutions = sum(9 * a * b + 2 * b for a, b in pairwise([1, *vgg]))
    dense_two = 49 * 8 * base * dense + dense * dense + 4 * dense
    skips = sum(N_CLASSES * base * k + N_CLASSES for k in (1, 2, 4, 8))
    return convolutions + dense_two + skips + 16 * N_CLASSES * (dense + 4 * N_CLASSES)


def test_an_untrained_papers_network_says_little():
    """Its loss starts near log(12), from where it has to fall."""
    torch.manual_seed(0)
    network = build(PaperConfig(8, 32)).train()
    scores = network(torch.rand(2, 1, 64, 64)).scores
    loss = torch.nn.functional.cross_entropy(scores, torch.randint(0, N_CLASSES, (2, 64, 64)))
    assert loss.item() == pytest.approx(np.log(N_CLASSES), abs=0.3)


def test_deconvolutions_start_as_bilinear_interpolation():
    deconvolution = torch.nn.ConvTranspose2d(3, 3, 4, 2, bias=False)
    deconvolution.weight = torch.nn.Parameter(_bilinear(3, 3))
    ramp = torch.arange(6.0).expand(1, 3, 6, 6)
    with torch.no_grad():
        doubled = deconvolution(ramp)[..., 3:-3, 3:-3]
    expected = torch.arange(doubled.shape[-1]) / 2 + 0.75
    torch.testing.assert_close(doubled, expected.expand_as(doubled))


def test_the_librarys_network_keeps_the_images_size():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pytest.importorskip("segmentation_models_pytorch", exc_type=(ImportError, RuntimeError))
    with torch.no_grad():
        scores = build(SmpConfig()).eval()(torch.zeros(1, 1, SIZE, SIZE)).scores
    assert scores.shape == (1, N_CLASSES, SIZE, SIZE)
    with pytest.raises(CloudError, match="nonsense"):
        build(SmpConfig("nonsense"))


def test_a_missing_library_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "segmentation_models_pytorch", None)
    with pytest.raises(CloudError, match="pip install segmentation-models-pytorch"):
        build(SmpConfig())
