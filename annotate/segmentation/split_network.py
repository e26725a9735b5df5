"""Split of the suit network into an encoder of the whole image and a decoder for any part of it.

The first half computes features of every square of ``PLACE`` x ``PLACE`` samples. The second half computes
the scores of any part of an image from these features and the part's samples (docs/adr/0023).
"""

from google.protobuf.message import Message

from annotate.onnx_graph import keep_needed, parsed

PLACE = 4
INPUT, OUTPUT = "channels", "scores"
SHUFFLE = 2  # side in pixels of a cell, whose scores the last layer gives as channels


def split_network(file: bytes) -> tuple[bytes, bytes, str]:
    """Return the ONNX files of both halves, and the name of the feature tensor between them.

    The second half outputs scores (B, K, h, w). Where the last layer shuffles pixels, it outputs the scores
    before the shuffle, (B, 4 K, h / 2, w / 2). Raises ValueError for a file without an ONNX network, or a
    network without upsampled features.
    """
    model = parsed(file)
    # The last enlarged features join an image's own samples.
    enlargements = [node for node in model.graph.node if node.kind == "Resize"]
    if not enlargements or not enlargements[-1].input or not model.graph.input:
        raise ValueError("no input, or nothing is enlarged")
    context = enlargements[-1].input[0]
    return _part(model, {INPUT}, context), _part(model, {INPUT, context}, _unshuffled(model)), context


def _unshuffled(model: Message) -> str:
    """Return the name of the tensor whose pixel shuffle is ``OUTPUT``; ``OUTPUT`` without such a shuffle."""
    for node in model.graph.node:
        if OUTPUT in node.output and node.kind == "DepthToSpace":
            attributes = {one.name: one for one in node.attribute}
            side, mode = attributes.get("blocksize"), attributes.get("mode")
            if side and side.number == SHUFFLE and mode and mode.text == b"CRD":
                return str(node.input[0])
    return OUTPUT


def _part(model: Message, given: set[str], wanted: str) -> bytes:
    """Return the ONNX file with the nodes that compute ``wanted`` from ``given``."""
    part = type(model)()
    part.CopyFrom(model)
    graph, value = part.graph, type(model.graph.input[0])
    keep_needed(graph, given, {wanted})
    size = model.graph.input[0].type
    size.tensor.ClearField("shape")  # because the two inputs differ in shape
    for listed, names in ((graph.input, sorted(given)), (graph.output, [wanted])):
        del listed[:]
        listed.extend(value(name=name, type=size) for name in names)
    return bytes(part.SerializeToString())
