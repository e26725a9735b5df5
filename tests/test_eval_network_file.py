"""Weights from anywhere: a network of the right kind is opened, anything else refused in one line."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from annotate.crop import SIZE
from annotate.parts import N_CLASSES
from eval.network_file import SHIPPED_WEIGHTS, Network
from sensors.errors import FormatError


def test_absent_weights_are_named(tmp_path):
    for path in (tmp_path / "absent.onnx", tmp_path):
        with pytest.raises(FormatError, match="cannot be read"):
            Network(path)


def onnx_network(path: Path, classes: int, outside: str | None = None, softmax: bool = True) -> Path:
    """The least network there is: one 1x1 convolution; its weights outside the file where asked."""
    onnx = pytest.importorskip("onnx")
    helper, numpy_helper = onnx.helper, onnx.numpy_helper
    tensor = numpy_helper.from_array(np.ones((classes, 1, 1, 1), np.float32), "w")
    if outside is not None:
        tensor.ClearField("raw_data")
        tensor.data_location = onnx.TensorProto.EXTERNAL
        entry = tensor.external_data.add()
        entry.key, entry.value = "location", outside
    nodes = [helper.make_node("Conv", ["depth", "w"], ["s"])]
    nodes += [
        helper.make_node("Softmax" if softmax else "Relu", ["s"], ["p"], **({"axis": 1} if softmax else {}))
    ]
    shape = ["n", 1, SIZE, SIZE]
    graph = helper.make_graph(
        nodes,
        "least",
        [helper.make_tensor_value_info("depth", onnx.TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("p", onnx.TensorProto.FLOAT, ["n", classes, SIZE, SIZE])],
        [tensor],
    )
    opset = helper.make_opsetid("", 17)
    path.write_bytes(helper.make_model(graph, opset_imports=[opset], ir_version=8).SerializeToString())
    return path


def test_the_least_network_is_one(tmp_path):
    network = Network(onnx_network(tmp_path / "n.onnx", N_CLASSES))
    np.testing.assert_allclose(network.probabilities(np.zeros((1, SIZE, SIZE), np.float32)), 1 / N_CLASSES)


@pytest.mark.parametrize("classes", [1, 11, 13, 21])
def test_weights_of_another_class_count_say_so(tmp_path, classes):
    with pytest.raises(FormatError, match=rf"give \(1, {classes}, 212, 212\); give a network of 12 classes"):
        Network(onnx_network(tmp_path / "n.onnx", classes))


def test_a_network_without_softmax_says_so(tmp_path):
    with pytest.raises(FormatError, match="no probabilities; export the network with its softmax"):
        Network(onnx_network(tmp_path / "n.onnx", N_CLASSES, softmax=False))


@pytest.mark.parametrize("where", ["../secret.bin", "/etc/hostname", "beside.bin"])
def test_weights_that_point_to_other_files_are_refused(tmp_path, monkeypatch, where):
    """Their hash would not cover these, and the paths are whoever's who made the file."""
    folder = tmp_path / "in"
    folder.mkdir()
    monkeypatch.chdir(folder)
    for file in (tmp_path / "secret.bin", folder / "beside.bin"):
        file.write_bytes(bytes(4 * N_CLASSES))
    with pytest.raises(FormatError, match="keeps tensors in other files"):
        Network(onnx_network(folder / "n.onnx", N_CLASSES, outside=where))


class Bomb:
    """Touches a file when unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_what_is_no_network_is_refused_in_one_line_and_not_run(tmp_path, capfd):
    trace, path = tmp_path / "ran", tmp_path / "n.onnx"
    shipped = SHIPPED_WEIGHTS.read_bytes()
    contents = [
        pickle.dumps(Bomb(trace)), b"", np.random.default_rng(0).bytes(4000),
        shipped[: len(shipped) // 2], shipped[:-100], b"PK\x03\x04" + bytes(100),
    ]  # fmt: skip
    for content in contents:
        path.write_bytes(content)
        with pytest.raises(FormatError) as error:
            Network(path)
        assert "\n" not in str(error.value)
        assert str(path) in str(error.value)
    assert not trace.exists()
    assert capfd.readouterr() == ("", "")
