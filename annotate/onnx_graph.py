"""Changes of ONNX files without the package onnx: fewer input channels, fewer outputs."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError, Message

_TEXT, _NUMBER, _BYTES = "", "number", "bytes"
_FIELDS: dict[str, list[tuple[str, int, str, bool]]] = {
    "Model": [("graph", 7, "Graph", False)],
    "Graph": [("node", 1, "Node", True), ("initializer", 5, "Tensor", True),
              ("input", 11, "Value", True), ("output", 12, "Value", True)],
    "Node": [("input", 1, _TEXT, True), ("output", 2, _TEXT, True), ("kind", 4, _TEXT, False),
             ("attribute", 5, "Attribute", True)],
    "Attribute": [("name", 1, _TEXT, False), ("number", 3, _NUMBER, False), ("text", 4, _BYTES, False)],
    "Tensor": [("dims", 1, _NUMBER, True), ("dtype", 2, _NUMBER, False), ("name", 8, _TEXT, False),
               ("data", 9, _BYTES, False)],
    "Value": [("name", 1, _TEXT, False), ("type", 2, "Type", False)],
    "Type": [("tensor", 1, "TensorType", False)],
    "TensorType": [("shape", 2, "Shape", False)],
    "Shape": [],
}  # fmt: skip
"""Fields used of onnx.proto3: name, number, kind of value or name of message, repeated."""
_SCALES = frozenset({"QuantizeLinear", "DequantizeLinear", "Cast"})
"""Nodes that compute each number of their first input by itself."""


def parsed(file: bytes) -> Message:
    """Return the model of an ONNX file. Raises ValueError for another file."""
    try:
        return message_type("Model").FromString(file)
    except DecodeError as error:
        raise ValueError("no ONNX file") from error


def without_channels(file: bytes, image: str, kept: Sequence[int]) -> bytes:
    """Return the ONNX file of a network that takes only some channels of an image; the others count as 0.

    image: name of the input (B, n, h, w). kept: ascending channels. Raises ValueError where other nodes than
    convolutions read the image, or where a convolution's weights have another form.
    """
    model = parsed(file)
    graph = model.graph
    made_by = {name: node for node in graph.node for name in node.output}
    tensors = {tensor.name: tensor for tensor in graph.initializer}
    readers = [node for node in graph.node if any(_source(name, made_by) == image for name in node.input)]
    weights = set()
    for node in readers:
        if node.kind == "Conv" and _source(node.input[0], made_by) == image:
            weights.add(_source(node.input[1], made_by))
        elif node.kind not in _SCALES:
            raise ValueError(f"{node.kind} reads the image")
    if not weights or not weights <= set(tensors):
        raise ValueError("no convolution with constant weights reads the image")
    for name in weights:
        _choose(tensors[name], kept)
    for given in graph.input:
        if given.name == image:
            given.type.tensor.ClearField("shape")
    return bytes(model.SerializeToString())


def with_outputs(file: bytes, wanted: Sequence[str]) -> bytes:
    """Return the ONNX file of a network that computes only some outputs; the file itself without one of them.

    ONNX Runtime computes all outputs of a network, also those that a run does not name.
    """
    model = parsed(file)
    graph = model.graph
    outputs = {value.name: value for value in graph.output}
    if not set(wanted) <= set(outputs):
        return file
    keep_needed(graph, set(), set(wanted))
    chosen = [outputs[name] for name in wanted]
    del graph.output[:]
    graph.output.extend(chosen)
    return bytes(model.SerializeToString())


def keep_needed(graph: Message, given: set[str], wanted: set[str]) -> None:
    """Delete the nodes and constants of a graph that are not needed to compute ``wanted`` from ``given``."""
    made_by = {name: i for i, node in enumerate(graph.node) for name in node.output}
    needed, used, left = set(wanted), set(), list(wanted)
    while left:
        name = left.pop()
        if name in made_by and name not in given and made_by[name] not in used:
            used.add(made_by[name])
            left.extend(graph.node[made_by[name]].input)
            needed.update(graph.node[made_by[name]].input)
    nodes = [node for i, node in enumerate(graph.node) if i in used]
    constants = [tensor for tensor in graph.initializer if tensor.name in needed]
    for listed, new in ((graph.node, nodes), (graph.initializer, constants)):
        del listed[:]
        listed.extend(new)


def _source(name: str, made_by: dict[str, Message]) -> str:
    """Return the tensor that a tensor is scaled or cast from."""
    while name in made_by and made_by[name].kind in _SCALES:
        name = made_by[name].input[0]
    return name


def _choose(tensor: Message, kept: Sequence[int]) -> None:
    """Keep some input channels of a convolution's weights (out, in, h, w). Raises ValueError for another
    form.
    """
    if len(tensor.dims) != 4 or not tensor.data or not 0 <= kept[-1] < tensor.dims[1]:
        raise ValueError(f"weights of form {list(tensor.dims)}")
    size, rest = divmod(len(tensor.data), int(np.prod(tensor.dims)))
    if rest:
        raise ValueError("weights are incomplete")
    values = np.frombuffer(tensor.data, np.dtype((np.void, size))).reshape(tensor.dims)
    tensor.data = values[:, list(kept)].tobytes()
    tensor.dims[1] = len(kept)


@cache
def message_type(name: str) -> type[Message]:
    """Return the class of a message of onnx.proto3."""
    field = descriptor_pb2.FieldDescriptorProto
    scalars = {_TEXT: field.TYPE_STRING, _NUMBER: field.TYPE_INT64, _BYTES: field.TYPE_BYTES}
    file = descriptor_pb2.FileDescriptorProto(name="outline.proto", package="outline")
    for message_name, fields in _FIELDS.items():
        message = file.message_type.add(name=message_name)
        for own, number, kind, repeated in fields:
            added = message.field.add(name=own, number=number)
            added.label = field.LABEL_REPEATED if repeated else field.LABEL_OPTIONAL
            added.type = scalars.get(kind, field.TYPE_MESSAGE)
            if kind not in scalars:
                added.type_name = f".outline.{kind}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    whole: type[Message] = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"outline.{name}"))
    return whole
