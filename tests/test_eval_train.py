"""A training resumes bit for bit, refuses what is not its own, and its export is the network."""

import json
import math
import pickle
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from conftest import tree  # noqa: E402

from annotate.crop import SIZE  # noqa: E402
from annotate.parts import N_CLASSES  # noqa: E402
from eval.data import Crops, load_crops  # noqa: E402
from eval.networks import CompactUNet  # noqa: E402
from eval.predict import Network  # noqa: E402
from eval.train import Epoch, Schedule, evaluate, export_onnx, one_cycle, train  # noqa: E402
from sensors.errors import ExistsError, FormatError  # noqa: E402

SCHEDULE = Schedule(epochs=2, batch=2, seed=4)


@pytest.fixture(scope="module")
def crops(rig_session) -> Crops:
    return load_crops([rig_session.with_suffix(".truth")])


def quiet(epoch: Epoch) -> None:
    assert math.isfinite(epoch.loss)


def weights(model: CompactUNet) -> dict[str, np.ndarray]:
    return {name: tensor.numpy().copy() for name, tensor in model.state_dict().items()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory, crops) -> tuple[Path, CompactUNet, list[Epoch]]:
    """An uninterrupted training."""
    out = tmp_path_factory.mktemp("train") / "whole"
    return out, *train(crops, crops, out, SCHEDULE, quiet)


def assert_same(
    trained: tuple[CompactUNet, list[Epoch]], whole: tuple[Path, CompactUNet, list[Epoch]]
) -> None:
    for name, expected in weights(whole[1]).items():
        np.testing.assert_array_equal(weights(trained[0])[name], expected, err_msg=name)
    told = [[(e.number, e.loss, e.mean_recall, e.miou) for e in h] for h in (trained[1], whole[2])]
    assert told[0] == told[1]


def test_resumed_equals_uninterrupted_bit_for_bit(tmp_path, crops, whole):
    def interrupt(epoch: Epoch) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(crops, crops, tmp_path / "t", SCHEDULE, interrupt)
    told: list[Epoch] = []
    assert_same(train(crops, crops, tmp_path / "t", SCHEDULE, told.append), whole)
    assert [e.number for e in told] == [1]


def test_a_finished_training_is_only_read(crops, whole):
    before = tree(whole[0])
    assert_same(train(crops, crops, whole[0], SCHEDULE, lambda e: pytest.fail("trained again")), whole)
    assert tree(whole[0]) == before


def test_it_learns(whole):
    assert whole[2][-1].loss < whole[2][0].loss


def test_another_schedule_or_folder_is_refused(tmp_path, crops, whole):
    before = tree(whole[0])
    with pytest.raises(ExistsError, match="another training"):
        train(crops, crops, whole[0], Schedule(epochs=3, batch=2, seed=4), quiet)
    assert tree(whole[0]) == before
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ExistsError, match="is no training"):
        train(crops, crops, tmp_path, SCHEDULE, quiet)
    assert set(tree(tmp_path)) == {"mine.txt"}


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: b"",
        lambda data: data[: len(data) // 2],
        lambda data: pickle.dumps({"model": 1}),
        lambda data: (2**40).to_bytes(8, "little") + data[8:],
        lambda data: data[:8] + data[8:].replace(b"model.stem", b"model.stim", 1),
        lambda data: data[:8] + data[8:].replace(b'\\"number\\"', b'\\"nunber\\"', 1),
    ],
)
def test_a_broken_checkpoint_is_named_and_kept(tmp_path, crops, whole, spoil):
    path = tmp_path / "checkpoint.safetensors"
    (tmp_path / "schedule.json").write_bytes((whole[0] / "schedule.json").read_bytes())
    path.write_bytes(spoil((whole[0] / path.name).read_bytes()))
    before = tree(tmp_path)
    with pytest.raises(FormatError, match=r"checkpoint\.safetensors cannot be resumed"):
        train(crops, crops, tmp_path, SCHEDULE, quiet)
    assert tree(tmp_path) == before


def test_the_schedule_on_disk_is_the_schedule(whole):
    order = json.loads((whole[0] / "schedule.json").read_text())
    assert order.pop("data")["images"] == 3
    assert Schedule(**order) == SCHEDULE


def test_a_training_does_not_go_on_with_other_data(tmp_path, crops, whole):
    (tmp_path / "schedule.json").write_bytes((whole[0] / "schedule.json").read_bytes())
    with pytest.raises(ExistsError, match="data differ"):
        train(Crops(crops.depth[::-1], crops.parts), crops, tmp_path, SCHEDULE, quiet)


def test_the_export_is_the_network(tmp_path, crops, whole):
    path = tmp_path / "w.onnx"
    export_onnx(whole[1], path)
    x = crops.depth.astype(np.float32) / np.float32(65535)
    with torch.no_grad():
        expected = torch.softmax(whole[1].eval()(torch.from_numpy(x[:, None])), 1).numpy()
    np.testing.assert_allclose(Network(path).probabilities(x), expected, atol=1e-4)
    assert [p.name for p in tmp_path.iterdir()] == ["w.onnx"]


def test_evaluating_counts_every_defined_pixel_once(crops, whole):
    total = evaluate(whole[1], crops, batch=2)
    assert total.shape == (N_CLASSES, N_CLASSES)
    np.testing.assert_array_equal(total.sum(axis=1), [(crops.parts == i).sum() for i in range(N_CLASSES)])
    np.testing.assert_array_equal(total, evaluate(whole[1], crops, batch=3))


def test_one_cycle_goes_up_then_down_within_bounds():
    shares = np.linspace(0, 1, 501)
    rates = np.array([one_cycle(s) for s in shares])
    assert rates.min() > 0
    assert rates.max() <= 1
    top = int(rates.argmax())
    assert shares[top] == pytest.approx(0.3, abs=0.002)
    assert rates[top] == pytest.approx(1, abs=1e-4)
    assert (np.diff(rates[: top + 1]) >= 0).all()
    assert (np.diff(rates[top:]) <= 0).all()
    assert one_cycle(0) == pytest.approx(1 / 25)
    assert one_cycle(1) == pytest.approx(1e-4)
    assert one_cycle(0.3 - 1e-9) == pytest.approx(one_cycle(0.3), abs=1e-6)


@pytest.mark.parametrize("side", [2, 30, SIZE])
def test_the_network_keeps_the_images_size(side):
    with torch.no_grad():
        scores = CompactUNet().eval()(torch.zeros(2, 1, side, side))
    assert scores.shape == (2, N_CLASSES, side, side)
