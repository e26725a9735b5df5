"""Weights stored in half precision: files of half the size, computed with in full precision as before."""

from pathlib import Path

import numpy as np

from sensors.files.atomic import replacing

LEAST_HALVED = 1024
"""Numbers of a tensor from which it is stored in half precision: the others are no gain; chosen by eye."""


def halve_onnx(path: Path) -> None:
    """Store an ONNX file's larger tensors in half precision, each with a step that widens it when read.

    Needs the package onnx, which the extra 'train' brings.
    """
    import onnx
    from onnx import helper, numpy_helper

    model, widened = onnx.load(path), []
    for tensor in model.graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype == np.float32 and values.size >= LEAST_HALVED:
            name = tensor.name
            tensor.CopyFrom(numpy_helper.from_array(values.astype(np.float16), f"{name}_half"))
            widened.append(helper.make_node("Cast", [f"{name}_half"], [name], to=onnx.TensorProto.FLOAT))
    nodes = [*widened, *model.graph.node]
    del model.graph.node[:]
    model.graph.node.extend(nodes)
    with replacing(path) as temporary:
        onnx.save(model, temporary)
