"""Training of the suit network: samples keep their truth, it can be interrupted, its file is the network."""

import json
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from annotate.parts import LEFT_RIGHT, N_CLASSES, PAPER, UNDEFINED, swap_left_right
from annotate.segmentation.input_channels import CHANNELS, FELT, SEEN, SUBJECT, VALID, network_input
from annotate.segmentation.suit_network import (
    SHIPPED_SUIT_NETWORK,
    SuitNetwork,
    shipped_suit_network,
)
from eval.network.refine import SHIPPED_REFINEMENT_NETWORK
from eval.training.segmentation import train
from eval.training.segmentation.augmentation import (
    COLORS,
    LIKE,
    LIKE_PARTS,
    Sample,
    Sampling,
    degrade,
    draw_sample,
    flip,
    sample_as_labelled,
    without_unknown,
)
from eval.training.segmentation.examples import Example, ExampleFiles, Recording, store_examples
from eval.training.segmentation.network import (
    FULL_REFINEMENT_NETWORK,
    FULL_SUIT_NETWORK,
    SuitNet,
    export_suit_network,
    load_suit_network,
)
from eval.training.segmentation.scenes import rig_examples
from eval.training.segmentation.train import Stage, SuitTraining, sample_weights, train_stages
from eval.training.segmentation.validation import validate
from sensors.errors import CloudError, FormatError
from synth.rig.simulate import suit_path
from synth.rig.virtual_rig import DRAFT_PX, RigOptions, VirtualRig
from tools.fit import suit_network as fit
from tools.fit.quantise import quantise

SEEDS = st.integers(0, 2**32 - 1)
CLASSES = N_CLASSES + 1
DEPTH, BEFORE = CHANNELS.index("depth"), CHANNELS.index("before")
MIDDLE = np.minimum(np.arange(256), swap_left_right(np.arange(256, dtype=np.uint8)))
"""Parts without their side."""


def example(rng: np.random.Generator, height: int = 60, width: int = 70) -> Example:
    """A frame of random channels whose depth is the part, without its side."""
    planes = rng.integers(0, 256, (len(CHANNELS), height, width)).astype(np.uint8)
    target = rng.integers(0, CLASSES, (height, width)).astype(np.uint8)
    planes[DEPTH] = MIDDLE[target]
    planes[BEFORE] = target
    return Example(planes, target, np.array([100.0, 1.2]))


@given(SEEDS)
def test_a_drawn_sample_keeps_its_truth(seed):
    rng = np.random.default_rng(seed)
    planes, target = draw_sample(example(rng), Sampling(0.02, 32), rng)
    assert planes.shape == (len(CHANNELS), 32, 32) and target.shape == (32, 32)
    there = target != UNDEFINED
    assert there.any() and np.array_equal(there, (planes[0] & VALID) > 0)
    assert np.array_equal(planes[DEPTH][there], MIDDLE[target[there]])


def test_a_part_of_a_few_pixels_is_in_its_share_of_the_squares():
    """A foot below a blanket, far from the rest; squares about the subject never show it."""
    rng = np.random.default_rng(0)
    planes, target = example(rng, 320, 320)[:2]
    planes[0], target[:] = VALID, 0
    planes[0, :120, :120] |= SUBJECT
    target[20:100, 20:100], target[300:303, 300:303] = 2, 10
    frame, how = Example(planes, target, np.array([100.0, 1.2])), Sampling(0.012, 48, by_part=True)

    def share(how: Sampling) -> float:
        return np.mean([np.isin(draw_sample(frame, how, rng).target, (10, 11)).any() for _ in range(200)])

    assert 0.4 < share(how) < 0.6 and share(replace(how, by_part=False)) == 0


@given(SEEDS)
def test_a_flipped_sample_has_left_and_right_exchanged(seed):
    rng = np.random.default_rng(seed)
    sample = Sample(*example(rng)[:2])
    other, whole = flip(sample), flip(flip(sample))
    assert np.array_equal(whole.planes, sample.planes) and np.array_equal(whole.target, sample.target)
    for one, two in [pair[::turn] for pair in LEFT_RIGHT for turn in (1, -1)]:
        likeness = sample.planes[LIKE_PARTS][one - 1], other.planes[LIKE_PARTS][two - 1]
        assert np.array_equal(likeness[0][:, ::-1], likeness[1])
        for a, b in ((sample.planes[BEFORE], other.planes[BEFORE]), (sample.target, other.target)):
            assert np.array_equal((a == one)[:, ::-1], b == two)


@given(SEEDS)
def test_degrading_leaves_depth_and_invents_no_measurement(seed):
    rng = np.random.default_rng(seed)
    planes, kept = example(rng).planes, CHANNELS.index("off_plane") + 1
    planes[LIKE, :, :9] = 0  # unmeasured colours
    degraded = planes.copy()
    degrade(degraded, rng)
    assert np.array_equal(degraded[DEPTH:kept], planes[DEPTH:kept])
    assert not (~planes[0] & degraded[0]).any()
    assert not degraded[LIKE, :, :9].any()


@given(SEEDS)
def test_in_the_loss_parts_weigh_by_their_share_of_the_image(seed):
    rng = np.random.default_rng(seed)
    classes = np.append(rng.choice(np.arange(1, N_CLASSES), rng.integers(1, N_CLASSES), replace=False), 0)
    often = rng.choice(classes, (2, 24, 20), p=rng.dirichlet(np.full(len(classes), 5.0)))
    targets = torch.from_numpy(np.where(rng.random(often.shape) < 0.1, UNDEFINED, often)).long()
    targets[0, 0, 0] = CLASSES - 1
    weights = sample_weights(targets, N_CLASSES - 1)
    assert (weights[targets == UNDEFINED] == 0).all() and weights[0, 0, 0] == 1
    for image, weight in zip(targets, weights, strict=True):
        body = (image > 0) & (image < N_CLASSES)
        count = torch.bincount(image[body], minlength=N_CLASSES)
        seen = count > train.RAREST * body.sum()
        each = torch.bincount(image[body], weight[body].double(), minlength=N_CLASSES)[seen]
        if body.any():
            assert weight[body].mean().item() == pytest.approx(1, rel=1e-4)
            as_many = count[seen].double() ** (1 - train.BALANCE)
            assert (each / as_many).numpy() == pytest.approx(float(each[0] / as_many[0]), rel=1e-4)


def test_held_out_frames_are_sampled_as_labelling_does():
    whole = example(np.random.default_rng(0))
    sample = sample_as_labelled(whole, 0.024)
    assert sample.target.shape == (32, 48)
    assert np.array_equal(sample.planes[:, :30, :35], whole.planes[:, ::2, ::2])
    assert (sample.target[30:] == UNDEFINED).all() and (sample.target[:, 35:] == UNDEFINED).all()
    assert np.array_equal(without_unknown(sample).target, sample.target)


def trained_network(seed: int) -> SuitNet:
    """A network whose weights and statistics all differ, as after a training."""
    torch.manual_seed(seed)
    network = SuitNet().eval()
    with torch.no_grad():
        for values in network.state_dict().values():
            if values.is_floating_point():
                values += 0.02 * (torch.rand_like(values) - 0.5)
    return network


def chances(network, planes, temperature=1.0):
    """Probabilities (13, h, w) by a network in torch."""
    with torch.no_grad():
        scores = network(torch.from_numpy(network_input(planes, len(PAPER.parts))[None]))[0]
    return torch.softmax(scores / temperature, 0).numpy()


def test_a_file_is_the_network_and_reads_back(tmp_path):
    network, rng = trained_network(1), np.random.default_rng(1)
    export_suit_network(network, tmp_path / "w.onnx", 2.0)
    export_suit_network(load_suit_network(tmp_path / "w.onnx"), tmp_path / "again.onnx")
    for height, width in ((32, 48), (64, 16)):
        planes = example(rng, height, width).planes
        for name in ("w.onnx", "again.onnx"):
            found = SuitNetwork(tmp_path / name).probabilities(planes, 1)
            np.testing.assert_allclose(found, chances(network, planes, 2.0), atol=1e-4)
    found = SuitNetwork(FULL_SUIT_NETWORK).probabilities(planes, 1)
    np.testing.assert_allclose(found, chances(load_suit_network(FULL_SUIT_NETWORK), planes), atol=1e-4)
    (tmp_path / "w.onnx").write_bytes(b"another file")
    with pytest.raises(FormatError, match="train-labels"):
        load_suit_network(tmp_path / "w.onnx")


@pytest.fixture
def files(tmp_path):
    rng = np.random.default_rng(3)
    for name in "ab":
        store_examples([example(rng) for _ in range(3)], tmp_path / f"{name}.npz")
    return ExampleFiles([tmp_path / "a.npz"]), ExampleFiles([tmp_path / "b.npz"])


def test_examples_are_read_as_stored_or_refused(files, tmp_path):
    rng = np.random.default_rng(3)
    for index in range(3):
        for stored, given_one in zip(files[0][index], example(rng), strict=True):
            assert np.array_equal(stored, given_one)
    (tmp_path / "a.npz").write_bytes((tmp_path / "a.npz").read_bytes()[:-9])
    with pytest.raises(FormatError, match=r"a\.npz cannot be read"):
        ExampleFiles([tmp_path / "a.npz"])
    store_examples([], tmp_path / "none.npz")
    with pytest.raises(CloudError, match="check the palette"):
        ExampleFiles([tmp_path / "none.npz"])


def test_an_interrupted_training_ends_with_the_same_file(files, tmp_path, monkeypatch):
    monkeypatch.setattr(train, "BATCH", 2)
    monkeypatch.setattr(train, "CHECKPOINT_S", 0.0)
    stages = [Stage(Sampling(0.02, 16), 3, 1e-3, 0.99), Stage(Sampling(0.01, 32), 2, 1e-3, 0.99)]
    trainings = [SuitTraining(files[0], stage, n) for n, stage in enumerate(stages)]

    def run(name: str, watch) -> bytes:
        (tmp_path / name).mkdir(exist_ok=True)
        torch.manual_seed(0)
        train_stages(SuitNet(), trainings, files[1], tmp_path / name, watch)
        return (tmp_path / name / "reader.onnx").read_bytes()

    done: list[int] = []

    def killed(step: int, loss: float) -> None:
        done.append(step)
        if len(done) in (3, 4):  # at the end of the first stage, and in the second
            raise KeyboardInterrupt

    losses: list[float] = []
    whole = run("whole", lambda step, loss: losses.append(loss))
    assert len(losses) == 5 and all(np.isfinite(losses))
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            run("broken", killed)
    assert run("broken", killed) == whole and done == [1, 2, 3, 1, 2]


def test_given_weights_are_trained_further_on_the_chosen_recordings(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(train, "BATCH", 2)
    monkeypatch.setattr(fit, "CONTINUED", (Stage(Sampling(0.02, 16), 2, 1e-4, 0.99),))
    rng, seen = np.random.default_rng(4), []
    for number in (4006, 4007):  # of twelve recordings the last is held out: 4007 = 12 * 333 + 11
        (tmp_path / "examples").mkdir(exist_ok=True)
        store_examples([example(rng)] * (number - 4005), tmp_path / "examples" / f"{number}.npz")
    stages = train.train_stages
    monkeypatch.setattr(fit, "train_stages", lambda *given: seen.append(given) or stages(*given))
    options = ["--first", "4006", "--recordings", "2", "--start", str(FULL_SUIT_NETWORK)]
    monkeypatch.setattr("sys.argv", ["suit_network", str(tmp_path), *options])
    fit.main()
    ((_, (training,), held_out, *_),) = seen
    assert len(training.examples) == 1 and len(held_out) == 2
    start, found = (
        load_suit_network(path).state_dict() for path in (FULL_SUIT_NETWORK, tmp_path / "reader.onnx")
    )
    entering = [name for name in start if name.startswith("enter.") and "weight" in name]
    gap = max(float((found[name] - start[name]).abs().max()) for name in entering)
    assert 0 < gap < 0.01 and str(tmp_path / "reader.onnx") in capsys.readouterr().out


def test_labels_drawn_at_a_temperature_give_it_back(tmp_path):
    network, rng = trained_network(0), np.random.default_rng(0)
    with torch.no_grad():
        for values in network.leave.parameters():
            values *= 50
    examples = []
    for _ in range(4):
        planes = example(rng, 64, 48).planes
        turned = flip(Sample(planes, planes[0])).planes
        twins = [*swap_left_right(np.arange(CLASSES - 1, dtype=np.uint8)), CLASSES - 1]
        mean = (chances(network, planes, 2) + chances(network, turned, 2)[twins][:, :, ::-1]) / 2
        target = (np.log(mean) + rng.gumbel(size=mean.shape)).argmax(axis=0).astype(np.uint8)
        examples.append(Example(planes, target, np.array([100.0, 1.2])))
    store_examples(examples, tmp_path / "e.npz")
    stored = ExampleFiles([tmp_path / "e.npz"])
    found = validate(network, stored, 0.012)
    assert found.temperature == pytest.approx(2, rel=0.15)
    export_suit_network(network, tmp_path / "w.onnx", found.temperature)
    again = validate(load_suit_network(tmp_path / "w.onnx"), stored, 0.012)
    assert again.temperature == pytest.approx(1, abs=0.01)
    assert again[:2] == pytest.approx(found[:2], abs=0.01)


@pytest.mark.parametrize(
    ("shipped", "full"),
    [(SHIPPED_SUIT_NETWORK, FULL_SUIT_NETWORK), (SHIPPED_REFINEMENT_NETWORK, FULL_REFINEMENT_NETWORK)],
)
def test_a_shipped_network_labels_a_frame_of_the_rig_as_in_full_precision(shipped, full):
    rig = VirtualRig(1, 1, "clean", 3, RigOptions(draft=True))
    assert rig.calibration.color.width == DRAFT_PX
    (one,) = rig_examples(rig)
    own = (one.planes[0] & SUBJECT) > 0
    assert own.sum() > 5000 and ((one.target[own] > 0) & (one.target[own] < CLASSES)).mean() > 0.9
    assert 0.003 < one.pixel_m < 0.012
    if full == FULL_REFINEMENT_NETWORK:
        one.planes[LIKE], one.planes[COLORS] = 0, 0
        one.planes[0] &= np.uint8(255 ^ SEEN ^ FELT)
        one.planes[BEFORE] = np.where(one.target < CLASSES - 1, one.target, 0)
    planes = sample_as_labelled(one, 0.012).planes
    few, all_ = (SuitNetwork(path).probabilities(planes, 1) for path in (shipped, full))
    assert (few.argmax(axis=0) == all_.argmax(axis=0)).mean() > 0.995 and np.abs(few - all_).mean() < 0.005
    with pytest.raises(FormatError, match="full precision"):
        load_suit_network(shipped)


def test_quantisation_leaves_the_named_layers_and_refuses_unknown_names(tmp_path):
    export_suit_network(trained_network(1), tmp_path / "w.onnx")
    planes = example(np.random.default_rng(5), 48, 64).planes
    inputs = [{"channels": network_input(planes, len(PAPER.parts))[None]}]
    quantise(tmp_path / "w.onnx", inputs, tmp_path / "few.onnx", ["leave"])
    full, few = (SuitNetwork(tmp_path / name).probabilities(planes, 1) for name in ("w.onnx", "few.onnx"))
    assert 0 < np.abs(full - few).mean() < 0.02
    quantise(tmp_path / "w.onnx", inputs, tmp_path / "fewer.onnx", ["leave"], ["ask"])
    fewer = SuitNetwork(tmp_path / "fewer.onnx").probabilities(planes, 1)
    assert 0 < np.abs(fewer - few).mean() < 0.02
    for layers in ((["leave", "leaf"], []), (["leave"], ["leaf"])):
        with pytest.raises(ValueError, match="leaf"):
            quantise(tmp_path / "w.onnx", inputs, tmp_path / "none.onnx", *layers)
    assert not (tmp_path / "none.onnx").exists()


@contextmanager
def silent(what, total):
    yield lambda n: None


def test_the_verb_resumes_and_labels_are_made_by_its_network(
    rig_session, tmp_path, annotate_cloud, monkeypatch
):
    monkeypatch.setattr(train, "SAMPLING", replace(train.SAMPLING, side=32))
    out, suit = tmp_path / "w", suit_path(rig_session)
    verb = ("train-labels", rig_session, rig_session, "--out", out, "--steps", 2, "--json")
    recording = Recording.open(rig_session, rig_session.with_suffix(".truth"), suit)
    with monkeypatch.context() as patch:
        patch.setattr(train, "train_stages", lambda *given: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            train.train_labels([recording] * 2, out, 2, 0, silent)
    assert "another training" in annotate_cloud(*verb, "--seed", 1).err
    with monkeypatch.context() as patch:
        patch.setattr(Recording, "examples", None)  # the files are complete
        done = annotate_cloud(*verb).result
    assert done["frames"] == done["frames_held_out"] == 3 and not (out / "examples").exists()
    assert done["sha256"] == SuitNetwork(out / "reader.onnx").sha256 != shipped_suit_network().sha256
    assert "a finished training" in annotate_cloud(*verb).err
    weights, labels = out / "reader.onnx", tmp_path / "l"
    label = ("label", rig_session, "--suit", suit, "--weights", weights, "--out", labels)
    assert not annotate_cloud(*label).code
    manifest = json.loads((labels / "labelset.json").read_text())
    assert manifest["steps"]["label"]["weights_sha256"] == done["sha256"]


def test_mistakes_are_one_line(rig_session, rig_labels, tmp_path, annotate_cloud):
    for more, remedy in (((), "give two or more"), ((rig_session, "--truth", "x"), "give one --truth")):
        done = annotate_cloud("train-labels", rig_session, *more, "--out", tmp_path / "w")
        assert done.code == 1 and remedy in done.err and not (tmp_path / "w").exists()
    with pytest.raises(CloudError, match="automatic labels only"):
        Recording.open(rig_session, rig_labels.path, suit_path(rig_session))
