"""Weights from anywhere: a network of the right kind is opened, anything else refused in one line."""

import os
import pickle
import resource
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from annotate.crop import SIZE
from annotate.parts import N_CLASSES
from eval.network.onnx_network import SHIPPED_WEIGHTS, Network
from eval.network.onnx_operators import OPERATORS, check_operators
from sensors.errors import FormatError


def test_absent_weights_are_named(tmp_path):
    for path in (tmp_path / "absent.onnx", tmp_path):
        with pytest.raises(FormatError, match="cannot be read"):
            Network(path)


def written(path: Path, nodes: list, weights: dict[str, np.ndarray], **more: list) -> Path:
    """A network of these nodes from ``depth`` to ``p``; more: what else the model holds."""
    onnx = pytest.importorskip("onnx")
    helper = onnx.helper
    ends = [("depth", ["n", 1, SIZE, SIZE]), ("p", ["n", N_CLASSES, SIZE, SIZE])]
    inputs, outputs = (
        [helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape)] for name, shape in ends
    )
    tensors = [onnx.numpy_helper.from_array(value, name) for name, value in weights.items()]
    graph = helper.make_graph(nodes, "g", inputs, outputs, tensors)
    opsets = [helper.make_opsetid(domain, 17) for domain in ("", "mine")]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=8, **more)
    path.write_bytes(model.SerializeToString())
    return path


def test_a_loop_is_refused_before_it_runs(tmp_path):
    helper = pytest.importorskip("onnx").helper
    body = helper.make_graph([helper.make_node("Identity", ["c"], ["d"])], "b", [], [])
    loop = helper.make_node("Loop", ["n", "go", "depth"], ["p"], body=body)
    path = written(tmp_path / "n.onnx", [loop], {"n": np.array(2**62), "go": np.array(True)})
    with pytest.raises(FormatError, match="operator 'Loop' is none"):
        Network(path)
    hidden = helper.make_node("Relu", ["depth"], ["p"], body=body)
    with pytest.raises(FormatError, match="holds a graph"):
        Network(written(path, [hidden], {}))


def test_operators_of_the_files_own_are_refused(tmp_path):
    onnx = pytest.importorskip("onnx")
    relu = onnx.helper.make_node("Relu", ["depth"], ["p"])
    own = onnx.helper.make_function("mine", "Relu", ["x"], ["y"], [], [])
    with pytest.raises(FormatError, match="functions of its own"):
        Network(written(tmp_path / "n.onnx", [relu], {}, functions=[own]))
    theirs = onnx.helper.make_node("Relu", ["depth"], ["p"], domain="mine")
    with pytest.raises(FormatError, match="operator of 'mine'"):
        Network(written(tmp_path / "n.onnx", [theirs], {}))


@pytest.mark.parametrize("operator", ["Expand", "Conv"])
def test_no_operator_gets_any_amount_of_memory(tmp_path, operator):
    node = pytest.importorskip("onnx").helper.make_node(operator, ["depth", "w"], ["p"])
    weights = np.array([1, 110_000, SIZE, SIZE]) if operator == "Expand" else np.ones((110_000, 1, 1, 1))
    path = written(tmp_path / "n.onnx", [node], {"w": weights.astype("i8" if weights.ndim == 1 else "f4")})
    before = resource.getrlimit(resource.RLIMIT_DATA)
    with pytest.raises(FormatError, match="not a network"):
        Network(path)
    assert resource.getrlimit(resource.RLIMIT_DATA) == before
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 8_000_000  # kB; it asks for 20 GB


def test_a_run_that_takes_too_long_is_stopped(tmp_path, monkeypatch):
    """Before the file is opened with its constants computed: that knows no end."""
    helper = pytest.importorskip("onnx").helper
    names = ["w", *map(str, range(500))]
    nodes = [helper.make_node("MatMul", [a, "w"], [b]) for a, b in pairwise(names)]
    nodes += [helper.make_node("Add", ["depth", names[-1]], ["p"])]
    path = written(tmp_path / "n.onnx", nodes, {"w": np.eye(1000, dtype=np.float32)[None, None]})
    opened = []
    real = Network._open
    monkeypatch.setattr(Network, "_open", lambda *given: (opened.append(given[3:]), real(*given)))
    monkeypatch.setattr("eval.network.onnx_network.TRIAL_SECONDS", 0.05)
    with pytest.raises(FormatError, match="not a network"):
        Network(path)
    assert opened == [(["ConstantFolding"],)]


def test_what_an_export_writes_is_allowed(tmp_path):
    """Every kind of node in the shipped weights, by the package's own reader, and cut files are refused."""
    onnx = pytest.importorskip("onnx")
    data = SHIPPED_WEIGHTS.read_bytes()
    assert {node.op_type for node in onnx.load_from_string(data).graph.node} <= OPERATORS
    check_operators(data)
    for end in (10, 1000, len(data) - 1):
        with pytest.raises(FormatError, match="cut short"):
            check_operators(data[:end])


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


def test_weights_that_are_no_file_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "w.onnx")
    with pytest.raises(FormatError, match="is not a file"):
        Network(tmp_path / "w.onnx")
