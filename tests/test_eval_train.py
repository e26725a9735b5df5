"""A training resumes bit for bit from any step and refuses other trainings; the export is the network."""

import json
import pickle
import socket
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
import torch
from conftest import tree
from safetensors.torch import load_file

from annotate.crop import SIZE
from annotate.labelset.images import decode_parts
from annotate.parts import N_CLASSES, UNDEFINED
from eval.architecture.blocks import NetworkOutput
from eval.architecture.compact import CompactConfig
from eval.architecture.networks import build
from eval.architecture.reference_networks import PaperConfig
from eval.network.onnx_export import export_network
from eval.network.onnx_network import OnnxNetwork
from eval.training.augment import Augmentation
from eval.training.body_targets import ROW, no_targets
from eval.training.calibration.confidence_temperature import fitted_temperature
from eval.training.crops import Crops
from eval.training.loader import BatchOrder, Images, batches
from eval.training.plan import Loss, ModernRecipe, PaperRecipe, Plan, class_weights
from eval.training.processes import ALONE
from eval.training.resumable_loop import Progress, one_cycle
from eval.training.train import Data, Watch, evaluate, predicted, train, work_left
from sensors.errors import CloudError, ExistsError, FormatError
from tests.helpers import tiny_training
from tests.helpers.tiny_training import CROPS, PLAN, small_crops

TINY = PLAN.network
BOTH = Data(CROPS, CROPS)
Result = tuple[torch.nn.Module, Progress]


def weights(model: torch.nn.Module) -> dict[str, np.ndarray]:
    return {name: tensor.numpy().copy() for name, tensor in model.state_dict().items()}


def assert_same(a: Result, b: Result) -> None:
    for name, expected in weights(b[0]).items():
        np.testing.assert_array_equal(weights(a[0])[name], expected, err_msg=name)
    assert [replace(e, seconds=0) for e in a[1].epochs] == [replace(e, seconds=0) for e in b[1].epochs]
    assert (a[1].points, a[1].step) == (b[1].points, b[1].step)


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Bits are the same for one number of threads, as in the other processes here."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> tuple[Path, Result]:
    """An uninterrupted training."""
    out = tmp_path_factory.mktemp("train") / "whole"
    return out, train(BOTH, out, PLAN, ALONE)


def interrupted_at(image: int) -> Watch:
    """Watch that stops a training after so many images; it is saved after each step."""
    left = [image]

    def advance(n: int) -> None:
        left[0] -= n
        if left[0] <= 0:
            raise KeyboardInterrupt

    return Watch(advance, checkpoint_s=0.0)


def test_a_training_by_the_clock_counts_its_seconds(tmp_path):
    plan, seen = replace(PLAN, minutes=1.6 / 60), []
    assert work_left(tmp_path / "t", plan, CROPS) == (2, "seconds")
    _, progress = train(BOTH, tmp_path / "t", plan, ALONE, Watch(seen.append))
    assert sum(seen) == int(progress.seconds) >= 1
    assert work_left(tmp_path / "t", plan, CROPS) == (max(0, 2 - int(progress.seconds)), "seconds")


@pytest.mark.parametrize("image", [2, 6, 8])
def test_resumed_anywhere_equals_uninterrupted_bit_for_bit(tmp_path, whole, image):
    """Within an epoch (3 steps of 2 images) and at its end."""
    with pytest.raises(KeyboardInterrupt):
        train(BOTH, tmp_path / "t", PLAN, ALONE, interrupted_at(image))
    assert work_left(tmp_path / "t", PLAN, CROPS) == (18 - image, "images")
    seen: list[int] = []
    assert_same(train(BOTH, tmp_path / "t", PLAN, ALONE, Watch(seen.append)), whole[1])
    assert sum(seen) == 18 - image


def test_dropout_and_momentum_resume_too(tmp_path):
    """The paper's network and recipe: random numbers and velocities are part of the state."""
    plan = Plan(PaperConfig(2, 4), PaperRecipe(batch=2, rate=1e-7), epochs=2, seed=1)
    data = Data(small_crops(4))
    expected = train(data, tmp_path / "a", plan, ALONE)
    with pytest.raises(KeyboardInterrupt):
        train(data, tmp_path / "b", plan, ALONE, interrupted_at(2))
    assert_same(train(data, tmp_path / "b", plan, ALONE), expected)
    assert expected[1].epochs[-1].mean_recall is None


def test_killed_without_warning_it_resumes(tmp_path, whole):
    """SIGKILL at whatever moment the checkpoint first appears."""
    out = tmp_path / "t"
    child = tiny_training.begin(out)
    while not (out / "checkpoint.safetensors").is_file() and child.is_alive():
        time.sleep(0.002)
    child.kill()
    child.join()
    assert_same(train(BOTH, out, PLAN, ALONE), whole[1])


def test_two_processes_train_the_network_of_one(tmp_path, whole):
    """As torchrun starts them: both finish, the first one writes; sums are rounded in another order."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = str(taken.getsockname()[1])
    group = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
    children = [tiny_training.begin(tmp_path / "t", RANK=str(r), LOCAL_RANK=str(r), **group) for r in (0, 1)]
    try:
        for child in children:
            child.join(600)
    finally:
        for child in children:
            child.kill()
    assert [child.exitcode for child in children] == [0, 0]
    history = json.loads((tmp_path / "t" / "history.json").read_text())
    assert history["processes"] == 2
    network, alone = whole[1]
    for epoch, expected in zip(history["epochs"], alone.epochs, strict=True):
        assert epoch["loss"] == pytest.approx(expected.loss, rel=1e-5)
        assert epoch["mean_recall"] == pytest.approx(expected.mean_recall, abs=0.01)
    state = load_file(tmp_path / "t" / "checkpoint.safetensors")
    for name, expected in weights(network).items():
        np.testing.assert_allclose(state["average." + name].numpy(), expected, atol=1e-3, err_msg=name)


def test_each_epoch_has_every_crop_once_shared_by_processes_and_made_by_workers():
    steps = list(BatchOrder(images=7, batch=3, epochs=2, seed=1).after(0))
    for epoch in (0, 1):
        seen = [i for batch in steps for e, i in batch if e == epoch]
        assert len(set(seen)) == len(seen) == 6
    assert steps == list(BatchOrder(7, 3, 2, 1).after(0)) != list(BatchOrder(7, 3, 2, 2).after(0))
    assert [len(batch) for batch in BatchOrder(2, 16, 3, 0).after(0)] == [2, 2, 2]
    alone = list(BatchOrder(11, 4, 2, 3).after(0))
    shares = [list(BatchOrder(11, 4, 2, 3, rank, 2).after(0)) for rank in (0, 1)]
    for batch, a, b in zip(alone, *shares, strict=True):
        assert sorted(a + b) == sorted(batch)
        assert not set(a) & set(b)
    for step in range(5):
        assert list(BatchOrder(11, 4, 2, 3).after(step)) == alone[step:]
    with pytest.raises(CloudError, match="2 processes"):
        BatchOrder(1, 4, 2, 3, 0, 2)
    images, order = Images(CROPS, Augmentation(), 5), BatchOrder(7, 2, 1, 5)
    alone, ahead = (list(batches(images, order, 1, workers)) for workers in (0, 2))
    assert len(alone) == 2
    for a, b in zip(alone, ahead, strict=True):
        assert all(
            torch.equal(x.float().nan_to_num(), y.float().nan_to_num()) for x, y in zip(a, b, strict=True)
        )


def test_a_finished_training_is_only_read(whole):
    before = tree(whole[0])
    watch = Watch(lambda n: pytest.fail("trained again"))
    assert_same(train(BOTH, whole[0], PLAN, ALONE, watch), whole[1])
    assert tree(whole[0]) == before


def test_it_learns_reports_and_labels_one_frame(whole, monkeypatch):
    told, seen, (out, (network, progress)) = [], [], whole
    epochs = progress.epochs
    assert epochs[-1].loss < epochs[0].loss
    history = json.loads((out / "history.json").read_text())
    assert history["plan"] == PLAN.described()
    assert [e["number"] for e in history["epochs"]] == [1, 2, 3]
    assert history["epochs"][-1]["mean_recall"] == epochs[-1].mean_recall
    monkeypatch.setattr("eval.training.train.POINT_STEPS", 1)
    _, again = train(Data(CROPS), out.with_name("again"), PLAN, ALONE, Watch(seen.append, told.append))
    assert [point.images for point in again.points] == [2 * (i + 1) for i in range(9)]
    losses = np.reshape([point.loss for point in again.points], (3, 3))
    np.testing.assert_allclose([epoch.loss for epoch in again.epochs], losses.mean(axis=1))
    assert seen == [2] * 9
    assert [e.number for e in told] == [1, 2, 3] and all(e.miou is None for e in told)
    names = sorted(p.name for p in (out / "frame").iterdir())
    assert names == ["depth.png", *(f"epoch-{n:03d}.parts.png" for n in range(4)), "truth.parts.png"]
    last = decode_parts((out / "frame" / "epoch-003.parts.png").read_bytes())
    np.testing.assert_array_equal(last, next(predicted(network, CROPS))[0])


def test_another_plan_data_start_or_folder_is_refused(tmp_path, whole):
    before = tree(whole[0])
    mixed = zip(map(CROPS.depth, reversed(range(7))), map(CROPS.parts, range(7)), CROPS.wholes, strict=True)
    for plan, data in (
        (replace(PLAN, epochs=4), BOTH),
        (replace(PLAN, network=CompactConfig((4, 6), 1)), BOTH),
        (PLAN, Data(Crops.of(mixed), CROPS)),
        (PLAN, Data(CROPS, CROPS, build(TINY))),
    ):
        with pytest.raises(ExistsError, match="another training"):
            train(data, whole[0], plan, ALONE)
    assert tree(whole[0]) == before
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ExistsError, match="is not a training"):
        train(BOTH, tmp_path, PLAN, ALONE)
    assert set(tree(tmp_path)) == {"mine.txt"}


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: b"",
        lambda data: data[: len(data) // 2],
        lambda data: pickle.dumps({"model": 1}),
        lambda data: (2**40).to_bytes(8, "little") + data[8:],
        lambda data: data[:8] + data[8:].replace(b"model.stem", b"model.stim", 1),
        lambda data: data[:8] + data[8:].replace(b'\\"step\\"', b'\\"stop\\"', 1),
    ],
)
def test_a_broken_checkpoint_is_named_and_kept(tmp_path, whole, spoil):
    path = tmp_path / "checkpoint.safetensors"
    (tmp_path / "plan.json").write_bytes((whole[0] / "plan.json").read_bytes())
    path.write_bytes(spoil((whole[0] / path.name).read_bytes()))
    before = tree(tmp_path)
    with pytest.raises(FormatError, match=r"checkpoint\.safetensors .*remove it") as error:
        train(BOTH, tmp_path, PLAN, ALONE)
    assert "\n" not in str(error.value)
    assert tree(tmp_path) == before


def test_one_image_is_enough_and_an_exploding_loss_is_refused(tmp_path):
    one = small_crops(1)
    assert train(Data(one, one), tmp_path / "t", PLAN, ALONE)[1].step == 3
    plan = replace(PLAN, recipe=PaperRecipe(batch=2, rate=1e30))
    with pytest.raises(CloudError, match="not finite"):
        train(Data(CROPS), tmp_path / "u", plan, ALONE)


def test_training_continues_from_a_start(tmp_path, whole):
    """Weights stay at a rate of almost nothing."""
    plan = replace(PLAN, recipe=ModernRecipe(2, peak_rate=1e-12, weight_decay=0), epochs=1)
    start = build(TINY)
    start.load_state_dict(whole[1][0].state_dict())
    model, _ = train(Data(CROPS, start=start), tmp_path / "t", plan, ALONE)
    for name, value in weights(whole[1][0]).items():
        if name.endswith("weight"):
            np.testing.assert_allclose(weights(model)[name], value, atol=1e-9)


def test_losses_are_over_the_pixels_of_their_recipe():
    """Modern: labelled pixels with depth, weighted; paper: a sum over all labelled pixels."""
    rng = np.random.default_rng(0)
    scores = torch.from_numpy(rng.normal(size=(2, N_CLASSES, 5, 5)).astype(np.float32))
    depth = torch.from_numpy((rng.random((2, 1, 5, 5)) < 0.6).astype(np.float32))
    parts = torch.from_numpy(rng.choice([0, 3, 7, UNDEFINED], (2, 5, 5)).astype(np.uint8))
    weight, chosen = torch.linspace(0.5, 2, N_CLASSES), torch.log_softmax(scores, 1)
    batch = depth, parts, torch.zeros(2, ROW)
    labelled = [(b, v, u, int(parts[b, v, u])) for b, v, u in np.ndindex(2, 5, 5) if parts[b, v, u] < 255]
    modern = [-weight[c] * chosen[b, c, v, u] for b, v, u, c in labelled if depth[b, 0, v, u] > 0]
    loss, told = Loss(ModernRecipe(), weight).of(NetworkOutput(scores), batch)
    assert float(loss) == pytest.approx(float(sum(modern) / len(modern)), rel=1e-5)
    assert told == pytest.approx(float(loss))
    paper = [-chosen[b, c, v, u] for b, v, u, c in labelled]
    summed, told = Loss(PaperRecipe(), weight).of(NetworkOutput(scores), batch)
    assert float(summed) == pytest.approx(float(sum(paper)), rel=1e-5)
    assert told == pytest.approx(float(sum(paper)) / len(paper), rel=1e-5)


def test_rare_parts_weigh_more_and_the_mean_pixel_one():
    parts = np.array([[1] * 75 + [2] * 20 + [3] * 5 + [0] * 40 + [UNDEFINED] * 9], np.uint8)
    weight = class_weights(ModernRecipe(balance=0.5), parts).numpy()
    assert weight[0] == weight[3] > weight[2] > weight[1]
    assert weight[2] / weight[1] == pytest.approx((75 / 20) ** 0.5)
    assert (weight[[1, 2, 3]] * [0.75, 0.2, 0.05]).sum() == pytest.approx(1)
    for recipe in (PaperRecipe(), ModernRecipe(balance=0)):
        np.testing.assert_allclose(class_weights(recipe, parts).numpy(), 1)


def test_the_export_is_the_network(tmp_path):
    torch.manual_seed(0)
    model, path = build(TINY), tmp_path / "w.onnx"
    export_network(model, path)
    x = np.where(np.random.default_rng(0).random((2, SIZE, SIZE)) < 0.3, 0.5, 0).astype(np.float32)
    with torch.no_grad():
        expected = torch.softmax(model.eval()(torch.from_numpy(x[:, None])).scores, 1).numpy()
    found = OnnxNetwork(path, flip=False).probabilities(x)
    seen = np.broadcast_to(x[:, None] > 0, found.shape)
    np.testing.assert_allclose(found[seen], expected[seen], atol=1e-4)
    np.testing.assert_array_equal(found[:, 0][x == 0], 1)
    np.testing.assert_array_equal(found[:, 1:].max(axis=1)[x == 0], 0)
    assert [p.name for p in tmp_path.iterdir()] == ["w.onnx"]


class Constant(torch.nn.Module):
    """Network that gives every pixel the same scores (12,)."""

    def __init__(self, scores: torch.Tensor) -> None:
        super().__init__()
        self.scores = torch.nn.Parameter(scores)

    def forward(self, depth: torch.Tensor) -> NetworkOutput:
        return NetworkOutput(self.scores[:, None, None].expand(len(depth), N_CLASSES, *depth.shape[-2:]))


def test_a_temperature_makes_overconfident_scores_probabilities():
    """Scores three times as large as the logarithms of the true chances: divided by three they are these."""
    rng = np.random.default_rng(0)
    parts = np.where(rng.random((8, 40, 40)) < 0.8, 1, 2).astype(np.uint8)
    crops = Crops.of((np.full((40, 40), 9000, np.uint16), image, no_targets()) for image in parts)
    share = (parts == 1).mean()
    scores = torch.full((N_CLASSES,), -100.0)
    scores[1], scores[2] = 3 * np.log(share), 3 * np.log(1 - share)
    assert fitted_temperature(Constant(scores), crops) == pytest.approx(3, abs=0.2)


def test_evaluation_counts_every_defined_pixel_once(whole):
    depth, parts = next(CROPS.batches(len(CROPS)))
    parts[:, :6, :6] = UNDEFINED
    crops = Crops.of(zip(map(CROPS.depth, range(7)), parts, CROPS.wholes, strict=True))
    total = evaluate(whole[1][0], crops, batch=2)
    np.testing.assert_array_equal(total.sum(axis=1), [(parts == i).sum() for i in range(N_CLASSES)])
    np.testing.assert_array_equal(total, evaluate(whole[1][0], crops, batch=3))
    scores = torch.tensor([9.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0])
    labels = np.concatenate(list(predicted(Constant(scores), CROPS, batch=3)))
    np.testing.assert_array_equal(labels, np.where(depth > 0, 5, 0))


def test_one_cycle_goes_up_then_down_within_bounds():
    shares = np.linspace(0, 1, 501)
    rates = np.array([one_cycle(s) for s in shares])
    top = int(rates.argmax())
    assert shares[top] == pytest.approx(0.03, abs=0.002)
    assert rates[top] == pytest.approx(1, abs=1e-4) and rates.max() <= 1
    assert (np.diff(rates[: top + 1]) >= 0).all() and (np.diff(rates[top:]) <= 0).all()
    assert [one_cycle(0), one_cycle(1)] == pytest.approx([1 / 25, 1e-4])
    schedule = Plan(recipe=PaperRecipe()).schedule(1, 0)
    assert schedule.rate(0.3) == schedule.rate(1.0) == 1e-10
