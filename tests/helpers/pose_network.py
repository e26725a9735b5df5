"""Pose networks as ONNX files for tests: every landmark lies at the brightest place of the image."""

import onnx
from onnx import TensorProto, helper

WIDTH, HEIGHT, CELL = 48, 64, 4


def pose_onnx(kind: str, landmarks: int = 17) -> bytes:
    """Return a network with SimCC outputs or heat maps of the brightness over cells of 4 pixels."""
    nodes = [
        helper.make_node("ReduceMean", ["image"], ["grey"], axes=[1], keepdims=1),
        helper.make_node("AveragePool", ["grey"], ["mean"], kernel_shape=[CELL] * 2, strides=[CELL] * 2),
        helper.make_node("Expand", ["mean", "shape"], ["raw"]),
        helper.make_node("Clip", ["raw", "zero"], ["heat"]),
    ]
    shape = [1, landmarks, HEIGHT // CELL, WIDTH // CELL]
    outputs = [("heat", shape)]
    if kind == "simcc":
        nodes += [
            helper.make_node("ReduceMax", ["heat"], ["columns"], axes=[2], keepdims=0),
            helper.make_node("ReduceMax", ["heat"], ["rows"], axes=[3], keepdims=0),
        ]
        outputs = [("columns", [1, landmarks, shape[3]]), ("rows", [1, landmarks, shape[2]])]
    graph = helper.make_graph(
        nodes,
        "pose",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, HEIGHT, WIDTH])],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, size) for name, size in outputs],
        [
            helper.make_tensor("shape", TensorProto.INT64, [4], shape),
            helper.make_tensor("zero", TensorProto.FLOAT, [], [0.0]),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(model)
    return model.SerializeToString()
