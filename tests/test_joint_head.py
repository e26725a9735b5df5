"""Joint head: one peak gives the place, deviations do not move it, older weights start it."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from annotate.crop import SIZE  # noqa: E402
from annotate.parts import PAPER  # noqa: E402
from annotate.scheme.scheme_file import load_scheme  # noqa: E402
from eval.architecture.blocks import NetworkOutput  # noqa: E402
from eval.architecture.compact import CompactConfig  # noqa: E402
from eval.architecture.joint_head import HEAD, PEAK, WINDOW, located  # noqa: E402
from eval.architecture.networks import build  # noqa: E402
from eval.network.body_state import BodyState  # noqa: E402
from eval.network.onnx_export import export_network  # noqa: E402
from eval.network.onnx_network import JOINT_OUTPUTS, OnnxNetwork  # noqa: E402
from eval.network.weights_file import load_weights, read_tensors, save_weights, write_tensors  # noqa: E402
from eval.scores.joint_visibility import HIDDEN, OUTSIDE, VISIBLE, visibility  # noqa: E402
from eval.scores.joints import N_JOINTS, TWIN  # noqa: E402
from eval.training.body_targets import JOINTS, no_targets  # noqa: E402
from eval.training.calibration.deviation_factors import fitted_deviation_factors  # noqa: E402
from eval.training.crops import Crops  # noqa: E402
from eval.training.expansion import expanded  # noqa: E402
from eval.training.joint_loss import JointTargets, JointWeights, joint_losses  # noqa: E402
from sensors.rig.camera import Intrinsics  # noqa: E402

TINY = CompactConfig((4, 8, 8), 1)


def maps_of(seed, size=20):
    generator = torch.Generator().manual_seed(seed)
    return 3 * torch.randn(2, 2, N_JOINTS, size, size, generator=generator)


def network(scheme=PAPER):
    torch.manual_seed(0)
    made = build(TINY, scheme).eval()
    with torch.no_grad():
        for values in made.parameters():
            values.add_(0.2 * torch.randn_like(values))
    return made


def test_places_are_a_naive_twin_s():
    maps = maps_of(0)
    found, share, _ = located(maps)
    for b, j in np.ndindex(2, N_JOINTS):
        heat, depth = maps[b, 0, j].double().numpy(), maps[b, 1, j].double().numpy()
        sums = np.pad(np.exp(heat), PEAK)
        sides = [
            [sums[v : v + 2 * PEAK + 1, u : u + 2 * PEAK + 1].sum() for u in range(20)] for v in range(20)
        ]
        v, u = np.unravel_index(np.argmax(sides), heat.shape)
        near = np.s_[max(0, v - WINDOW) : v + WINDOW + 1, max(0, u - WINDOW) : u + WINDOW + 1]
        odds = np.exp(heat[near] - heat.max())
        odds /= odds.sum()
        rows, columns = np.indices(heat.shape)[:, *near]
        expected = ((odds * (columns + 0.5)).sum() / 20, (odds * (rows + 0.5)).sum() / 20)
        np.testing.assert_allclose(found[b, j], [*expected, (odds * depth[near]).sum()], rtol=1e-5)
        assert float(share[b, j].sum()) == pytest.approx(1, abs=1e-5)


def test_of_two_peaks_the_higher_is_the_place_and_not_their_middle():
    maps = torch.zeros(1, 2, N_JOINTS, 21, 21)
    maps[:, 0, :, 10, 3], maps[:, 0, :, 10, 17] = 9.0, 10.0
    maps[:, 1, :, :, :10], maps[:, 1, :, :, 10:] = 0.2, 0.7
    np.testing.assert_allclose(located(maps)[0][0, 0], [17.5 / 21, 10.5 / 21, 0.7], atol=0.01)


def test_deviations_do_not_move_joints():
    made, images = network(), torch.rand(2, 1, 64, 64)
    targets = JointTargets.of(torch.rand(2, N_JOINTS, 3), images)
    only = JointWeights(heat=0, depth=0, deviation=1, state=0, place=0)
    sum((loss * counted).sum() for loss, counted in joint_losses(made(images), targets, only)).backward()
    moved = {n for n, p in made.named_parameters() if p.grad is not None and p.grad.abs().max() > 0}
    assert moved and all(name.startswith(f"{HEAD}deviation.") for name in moved)


class Centred(torch.nn.Module):
    """Network that places every joint in the middle, with one deviation."""

    def __init__(self, sd: float) -> None:
        super().__init__()
        self.sd = torch.nn.Parameter(torch.tensor(sd))

    def forward(self, depth: torch.Tensor) -> NetworkOutput:
        shapes = (2,), (6,), (N_JOINTS, 3), (N_JOINTS, 2), (N_JOINTS, 3)
        facing, posture, joints, sd, states = (torch.ones(len(depth), *shape) for shape in shapes)
        scores = torch.zeros(len(depth), 12, 2, 2)
        return NetworkOutput(scores, facing, posture, joints / 2, sd * self.sd, states)


def test_a_joint_of_unknown_depth_trains_its_place_alone():
    images = torch.rand(1, 1, SIZE, SIZE)
    output = network()(images)
    whole = torch.rand(1, N_JOINTS, 3)
    part = whole.clone()
    part[..., 2] = torch.nan
    full, placed = (
        joint_losses(output, JointTargets.of(joints, images), JointWeights()) for joints in (whole, part)
    )
    for n, ((loss, known), (own, counted)) in enumerate(zip(full, placed, strict=True)):
        if n < 2:
            assert torch.equal(known, counted) and torch.equal((loss * known), (own * counted))
        else:
            assert not counted.any() and torch.isfinite(own).all()


def test_calibrated_deviations_hold_68_percent_of_the_errors():
    rng, rows = np.random.default_rng(0), [no_targets() for _ in range(60)]
    for row in rows:
        row[JOINTS] = rng.normal(0.5, 0.1, 3 * N_JOINTS)
    images = np.full((60, 8, 8), 30_000, np.uint16), np.ones((60, 8, 8), np.uint8)
    crops = Crops.of(zip(*images, rows, strict=True))
    factors = fitted_deviation_factors(Centred(0.02), crops)
    truth = torch.tensor(np.array([row[JOINTS] for row in rows])).reshape(-1, N_JOINTS, 3)
    states = JointTargets.of(truth, torch.from_numpy(images[0][:, None] / 65535).float()).states
    errors = np.linalg.norm(truth - 0.5, axis=-1)
    for state in (HIDDEN, VISIBLE):
        within = errors[states == state] < factors[state] * 0.02 * 2**0.5
        assert np.mean(within) == pytest.approx(0.683, abs=0.01)
    assert factors[OUTSIDE] == 1.0
    assert fitted_deviation_factors(Centred(0.04), crops)[0] == pytest.approx(factors[0] / 2)


def test_states_are_those_of_the_scores():
    """Crops of a camera's whole image: the rule of ``joint_visibility``."""
    rng, camera = np.random.default_rng(0), Intrinsics(40, 40, 40.0, 40.0, 19.5, 19.5)
    depth_mm = rng.integers(1500, 2500, (8, 40, 40)).astype(np.uint16)
    depth_mm[rng.random(depth_mm.shape) < 0.3] = 0
    places = rng.uniform(-0.2, 1.2, (8, N_JOINTS, 3))
    true_mm = np.empty_like(places)
    true_mm[..., 2] = 1500 + 1000 * rng.random(places.shape[:2])
    true_mm[..., :2] = (places[..., :2] - 0.5) * true_mm[..., 2:]
    joints = np.dstack([places[..., :2], true_mm[..., 2] / 2000 - 0.5]).astype(np.float32)
    crops = np.where(depth_mm > 0, depth_mm / 2000 - 0.5, 0).astype(np.float32)
    found = JointTargets.of(torch.from_numpy(joints), torch.from_numpy(crops[:, None])).states.numpy()
    outside = (np.abs(places[..., :2] - 0.5) >= 0.5).any(axis=-1)
    seen = [visibility(one, depth, camera) for one, depth in zip(true_mm, depth_mm, strict=True)]
    np.testing.assert_array_equal(found, np.where(outside, OUTSIDE, np.stack(seen)))
    assert len(np.unique(found)) == 3


def test_weights_of_release_0_3_start_the_head(tmp_path):
    """Their heat maps are kept, and the rest of the head is the same in every process."""
    made, path = network(), tmp_path / "old.safetensors"
    save_weights(path, made, TINY)
    tensors, meta = read_tensors(path)
    kept = {n.replace(f"{HEAD}places", "places"): v for n, v in tensors.items()}
    write_tensors(path, {n: v for n, v in kept.items() if not n.startswith(HEAD)}, meta)
    first, second = load_weights(path).model, load_weights(path).model
    for name, value in first.state_dict().items():
        assert torch.equal(value, second.state_dict()[name])
    images = torch.rand(2, 1, 64, 64)
    with torch.no_grad():
        coarse = first.joint_head.places(torch.rand(1, 8, 8, 8))
        expected, found = made(images), first.eval()(images)
    assert coarse.shape == (1, 2 * N_JOINTS, 8, 8)
    np.testing.assert_array_equal(found.scores, expected.scores)
    assert not first.joint_head.correction.weight.any()


def test_an_exported_network_gives_flipped_joints_for_a_flipped_image_and_an_older_one_only_joints(tmp_path):
    import onnx

    path = tmp_path / "w.onnx"
    export_network(network(), path)
    rng = np.random.default_rng(0)
    depth = rng.integers(1500, 2500, (SIZE, SIZE)).astype(np.uint16)
    person = rng.random(depth.shape) < 0.7
    newer = OnnxNetwork(path)
    own, flipped = (
        BodyState.from_note(newer.segment(*images).bearing)
        for images in ((depth, person), (depth[:, ::-1], person[:, ::-1]))
    )
    np.testing.assert_allclose(flipped.joints_px[TWIN, 0], SIZE - 1 - own.joints_px[:, 0], atol=0.11)
    np.testing.assert_allclose(flipped.joints_sd[TWIN], own.joints_sd, atol=0.11)
    np.testing.assert_allclose(flipped.joints_seen[TWIN], own.joints_seen, atol=0.02)
    model = onnx.load(path)
    for output in [one for one in model.graph.output if one.name in JOINT_OUTPUTS]:
        model.graph.output.remove(output)
    onnx.save(model, path)
    older = BodyState.from_note(OnnxNetwork(path).segment(depth, person).bearing)
    assert older.joints_sd is older.joints_seen is None
    np.testing.assert_allclose(older.joints_px, own.joints_px, atol=0.11)


@pytest.mark.parametrize("scheme", ["atlas", "hands-and-feet"])
def test_finer_classes_leave_the_joints_where_they_were(scheme):
    new, made = load_scheme(scheme), network()
    images = torch.rand(2, 1, 64, 64)
    with torch.no_grad():
        expected, found = made(images), expanded(made, TINY, PAPER, new).eval()(images)
    for name in ("joints", "joint_sd", "joint_state"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-5)
