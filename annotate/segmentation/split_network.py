"""Split of the suit network into an encoder of the whole image and a decoder for any part of it.

The first half computes features of every square of ``PLACE`` x ``PLACE`` samples. The second half computes
the scores of any part of an image from these features and the part's samples (docs/adr/0023).
"""

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError, Message

PLACE = 4
INPUT, OUTPUT = "channels", "scores"
_FIELDS: dict[str, list[tuple[str, int, str, bool]]] = {
    "Model": [("graph", 7, "Graph", False)],
    "Graph": [("node", 1, "Node", True), ("initializer", 5, "Tensor", True),
              ("input", 11, "Value", True), ("output", 12, "Value", True)],
    "Node": [("input", 1, "", True), ("output", 2, "", True), ("kind", 4, "", False)],
    "Tensor": [("name", 8, "", False)],
    "Value": [("name", 1, "", False), ("type", 2, "Type", False)],
    "Type": [("tensor", 1, "TensorType", False)],
    "TensorType": [("shape", 2, "Shape", False)],
    "Shape": [],
}  # fmt: skip
"""Fields used of onnx.proto3: name, number, message ("" = text), repeated."""


def split_network(file: bytes) -> tuple[bytes, bytes, str]:
    """Return the ONNX files of both halves, and the name of the feature tensor between them.

    Raises ValueError for a file without an ONNX network, or a network without upsampled features.
    """
    try:
        model = _model().FromString(file)
    except DecodeError as error:
        raise ValueError("no ONNX file") from error
    # The last enlarged features join an image's own samples.
    enlargements = [node for node in model.graph.node if node.kind == "Resize"]
    if not enlargements or not enlargements[-1].input or not model.graph.input:
        raise ValueError("no input, or nothing is enlarged")
    context = enlargements[-1].input[0]
    return _part(model, {INPUT}, context), _part(model, {INPUT, context}, OUTPUT), context


def _part(model: Message, given: set[str], wanted: str) -> bytes:
    """Return the ONNX file with the nodes that compute ``wanted`` from ``given``."""
    part = type(model)()
    part.CopyFrom(model)
    graph, needed, kept = part.graph, {wanted}, []
    for node in reversed(model.graph.node):
        if needed & set(node.output) - given:
            needed |= set(node.input)
            kept.append(node)
    size = graph.input[0].type
    size.tensor.ClearField("shape")  # because the two inputs differ in shape
    for listed, new in (
        (graph.node, kept[::-1]),
        (graph.initializer, [tensor for tensor in model.graph.initializer if tensor.name in needed]),
        (graph.input, [type(graph.input[0])(name=name, type=size) for name in sorted(given)]),
        (graph.output, [type(graph.output[0])(name=wanted, type=size)]),
    ):
        del listed[:]
        listed.extend(new)
    return bytes(part.SerializeToString())


def _model() -> type[Message]:
    field = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="outline.proto", package="outline")
    for name, fields in _FIELDS.items():
        message = file.message_type.add(name=name)
        for own, number, kind, repeated in fields:
            added = message.field.add(name=own, number=number)
            added.label = field.LABEL_REPEATED if repeated else field.LABEL_OPTIONAL
            added.type = field.TYPE_MESSAGE if kind else field.TYPE_STRING
            if kind:
                added.type_name = f".outline.{kind}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    whole: type[Message] = message_factory.GetMessageClass(pool.FindMessageTypeByName("outline.Model"))
    return whole
