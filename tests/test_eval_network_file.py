"""Weights from anywhere: a network of the right kind is opened, anything else refused in one line."""

import json
import os
import pickle
from functools import cache
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
import torch
from safetensors.torch import save_file

from annotate.crop import SIZE
from annotate.parts import N_CLASSES
from annotate.scheme.scheme_file import load_scheme
from eval.architecture.compact import CompactConfig
from eval.architecture.networks import build
from eval.network import weights_file
from eval.network.onnx_export import export_network
from eval.network.onnx_network import SHIPPED_WEIGHTS, OnnxNetwork
from eval.network.weights_file import load_weights, save_weights
from eval.training.crops import to_crop
from sensors.errors import FormatError
from synth.images.presets import PRESETS, sample

TINY = CompactConfig((4, 6, 6), 1)


def test_absent_weights_and_pipes_are_refused_at_once(tmp_path):
    for path, why in ((tmp_path / "absent.onnx", "cannot be read"), (tmp_path, "is a folder")):
        with pytest.raises(FormatError, match=why):
            OnnxNetwork(path)
    os.mkfifo(tmp_path / "w.onnx")
    with pytest.raises(FormatError, match="is not a file"):
        OnnxNetwork(tmp_path / "w.onnx")


KINDS = "full", "float16 inside", "float16 throughout", "dynamic", "static"


@pytest.fixture(scope="module")
def full(tmp_path_factory) -> Path:
    """Return the shipped network in full precision."""
    pytest.importorskip("onnx")
    path = tmp_path_factory.mktemp("full") / "full.onnx"
    export_network(load_weights(SHIPPED_WEIGHTS.with_suffix(".safetensors"))[0].float(), path)
    return path


@pytest.fixture(scope="module")
def expected() -> np.ndarray:
    """Return the shipped network's probabilities of two crops."""
    return OnnxNetwork().probabilities(crops_of(2))


def converted(full: Path, folder: Path, kind: str) -> Path:
    """Return the network in full precision, or as ONNX Runtime's own tools convert that network."""
    onnx, quantization = pytest.importorskip("onnx"), pytest.importorskip("onnxruntime.quantization")
    out = folder / "n.onnx"
    if kind == "full":
        return full
    if kind.startswith("float16"):
        from onnxruntime.transformers.float16 import convert_float_to_float16

        halved = convert_float_to_float16(
            onnx.load(full), keep_io_types=kind == "float16 inside", op_block_list=["Resize"]
        )
        onnx.save(halved, out)
        return out
    # The first step that its makers advise.
    quantization.quant_pre_process(full, folder / "first.onnx", skip_symbolic_shape=True)
    if kind == "dynamic":
        quantization.quantize_dynamic(folder / "first.onnx", out, weight_type=quantization.QuantType.QUInt8)
    else:
        crops = iter([{"depth": x[None, None]} for x in crops_of(4)])
        reader = type(
            "Reader", (quantization.CalibrationDataReader,), {"get_next": lambda _: next(crops, None)}
        )
        quantization.quantize_static(folder / "first.onnx", out, reader(), quantization.QuantFormat.QDQ)
    return out


@cache
def crops_of(n: int) -> np.ndarray:
    """Crops as in training (n, 212, 212)."""
    return np.stack([to_crop(sample(PRESETS["sitting-train"], 0, 16 * i))[0] for i in range(n)])


@pytest.mark.parametrize("kind", KINDS)
def test_quantised_and_half_precision_exports_label_as_the_shipped_one(full, expected, tmp_path, kind):
    crops = crops_of(2)
    found = OnnxNetwork(converted(full, tmp_path, kind), scheme=load_scheme("atlas")).probabilities(crops)
    assert found.dtype == np.float32 and found.shape == expected.shape
    same = (found.argmax(1) == expected.argmax(1))[crops > 0].mean()
    assert same > (0.9 if kind in ("dynamic", "static") else 0.99), same


def test_a_network_just_as_large_as_allowed_opens(monkeypatch):
    size = SHIPPED_WEIGHTS.stat().st_size
    monkeypatch.setattr("eval.network.onnx_network.MAX_WEIGHT_BYTES", size)
    OnnxNetwork()
    monkeypatch.setattr("eval.network.onnx_network.MAX_WEIGHT_BYTES", size - 1)
    with pytest.raises(FormatError, match="larger than"):
        OnnxNetwork()


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


def test_probabilities_of_twelve_classes_are_required(tmp_path):
    path, nothing = tmp_path / "n.onnx", np.zeros((1, SIZE, SIZE), np.float32)
    network = OnnxNetwork(onnx_network(path, N_CLASSES))
    np.testing.assert_allclose(network.probabilities(nothing), 1 / N_CLASSES)
    for classes in (1, 11, 13):
        with pytest.raises(FormatError, match=rf"\(2, {classes}, 212, 212\) .* give a network of 12 classes"):
            OnnxNetwork(onnx_network(path, classes))
    with pytest.raises(FormatError, match="export the network with its softmax"):
        OnnxNetwork(onnx_network(path, N_CLASSES, softmax=False))


@pytest.mark.parametrize("where", ["../secret.bin", "/etc/hostname", "beside.bin"])
def test_weights_that_point_to_other_files_are_refused(tmp_path, monkeypatch, where):
    """Their hash would not cover these, and the file's maker chooses the paths."""
    folder = tmp_path / "in"
    folder.mkdir()
    monkeypatch.chdir(folder)
    for file in (tmp_path / "secret.bin", folder / "beside.bin"):
        file.write_bytes(bytes(4 * N_CLASSES))
    with pytest.raises(FormatError, match="keeps tensors in other files"):
        OnnxNetwork(onnx_network(folder / "n.onnx", N_CLASSES, outside=where))


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
        shipped[: len(shipped) // 2], shipped[:-99], b"PK\x03\x04" + bytes(100),
    ]  # fmt: skip
    for content in contents:
        path.write_bytes(content)
        with pytest.raises(FormatError) as error:
            OnnxNetwork(path)
        assert "\n" not in str(error.value)
        assert str(path) in str(error.value)
    assert not trace.exists()
    assert capfd.readouterr() == ("", "")


def test_weights_hold_their_network(tmp_path):
    path = tmp_path / "w.safetensors"
    network = build(TINY)
    save_weights(path, network, TINY)
    model, config, _ = load_weights(path)
    assert config == TINY
    for name, value in network.state_dict().items():
        assert torch.equal(model.state_dict()[name], value)
    save_weights(tmp_path / "again.safetensors", model, config)
    assert (tmp_path / "again.safetensors").read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda data: data[: len(data) // 2], "cannot be read as a safetensors file"),
        (lambda data: pickle.dumps({"model": 1}), "cannot be read as a safetensors file"),
        (lambda data: data.replace(b'\\"classes\\": 12', b'\\"classes\\": 13'), "13 classes"),
        (lambda data: data.replace(b"[4, 6, 6]", b"[4, 6, 7]"), "shape"),
        (lambda data: data.replace(b"[4, 6, 6]", b"[4,1e9,6]"), "malformed"),
        (lambda data: data.replace(b"compact", b"compost"), "does not describe a network"),
        (lambda data: data.replace(b'"network"', b'"netwerk"'), "does not hold weights"),
    ],
)
def test_weights_of_another_kind_are_refused_in_one_line(tmp_path, spoil, why):
    path = tmp_path / "w.safetensors"
    save_weights(path, build(TINY), TINY)
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(FormatError, match=why) as error:
        load_weights(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "network",
    [
        {"kind": "compact", "widths": [8192] * 5, "layers": 4, "classes": 12},
        {"kind": "paper", "base": 8192, "dense": 1, "classes": 12},
        {"kind": "smp", "encoder": "resnet18", "decoder": [8192] * 5, "classes": 12},
        [],
        None,
    ],
)
def test_a_claim_of_large_weights_takes_no_memory(tmp_path, monkeypatch, network):
    """The first three would take gigabytes; a file has the weights that it claims, or no network is built."""
    built = []
    real = weights_file.build
    monkeypatch.setattr(weights_file, "build", lambda *one: built.append(real(*one)) or built[-1])
    path = tmp_path / "w.safetensors"
    save_file({}, path, {"network": json.dumps(network)})
    with pytest.raises(FormatError) as error:
        load_weights(path)
    assert "\n" not in str(error.value)
    assert all(p.is_meta for model in built for p in model.parameters())


def test_live_loads_the_given_network(annotate_cloud, rig_session, tmp_path):
    (tmp_path / "mine.onnx").write_bytes(b"no network")
    done = annotate_cloud("live", rig_session, "--no-window", "--weights", tmp_path / "mine.onnx")
    assert done.code == 1 and "mine.onnx are not a network" in done.err and not done.out
