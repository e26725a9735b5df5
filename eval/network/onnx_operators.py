"""What an ONNX file would have executed, read off before ONNX Runtime opens it.

ONNX can loop without end and call functions of its own; a network that labels does neither. A file is one
protocol-buffers message (protobuf.dev, "Encoding"; field numbers from onnx.proto): only nodes are looked at,
weights are skipped. What this walker does not understand it refuses, so that nobody else reads more into it.
"""

from collections.abc import Iterator

from sensors.errors import FormatError

_NAMES = """
Abs Add And AveragePool BatchNormalization Cast Ceil Celu Clip Concat Constant ConstantOfShape Conv
ConvTranspose DepthToSpace Div Dropout Elu Equal Erf Exp Expand Flatten Floor Gather Gelu Gemm
GlobalAveragePool GlobalMaxPool Greater GreaterOrEqual GroupNormalization HardSigmoid HardSwish Identity
InstanceNormalization LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax LpNormalization MatMul
Max MaxPool Mean Min Mish Mod Mul Neg Not Or PRelu Pad Pow Reciprocal ReduceL2 ReduceMax ReduceMean
ReduceMin ReduceSum Relu Reshape Resize Round Selu Shape Sigmoid Sign Size Slice Softmax Softplus Softsign
SpaceToDepth Split Sqrt Squeeze Sub Sum Tanh ThresholdedRelu Transpose Unsqueeze Upsample Where
"""
OPERATORS = frozenset(_NAMES.split())
"""Those of our own exports, and those of convolutional networks and of attention: each is done once, and its
work is bounded by the sizes of what it takes and gives."""
DOMAINS = ("", "ai.onnx")
MAX_NODES = 20_000
"""The compact network has 98, the paper's 280; torchvision's largest segmenters have a few thousand."""
MAX_FIELDS = 1_000_000

_VARINT, _FIXED64, _LENGTH, _FIXED32 = 0, 1, 2, 5
_GRAPH, _TRAINING, _FUNCTIONS = 7, 20, 25
_NODE, _SPARSE_INITIALIZER = 1, 15
_OP_TYPE, _ATTRIBUTE, _DOMAIN = 4, 5, 7
_REFUSED_ATTRIBUTES = {6: "a graph", 11: "graphs", 22: "a sparse tensor", 23: "sparse tensors"}
"""Subgraphs are what Loop, Scan and If run; a sparse tensor of a few bytes unpacks to any size."""


def check_operators(data: bytes) -> None:
    """Raise FormatError naming the first thing in an ONNX file that no labelling network needs."""
    walker = _Walker()
    for model, graph in walker.messages(memoryview(data)):
        if model in (_TRAINING, _FUNCTIONS):
            raise FormatError("it holds functions of its own")
        if model == _GRAPH:
            _check_graph(walker, graph)


def _check_graph(walker: "_Walker", graph: memoryview) -> None:
    nodes = 0
    for number, node in walker.messages(graph):
        if number == _SPARSE_INITIALIZER:
            raise FormatError("it holds sparse weights")
        if number == _NODE:
            nodes += 1
            _check_node(walker, node)
    if nodes > MAX_NODES:
        raise FormatError(f"it has {nodes} nodes, more than {MAX_NODES}")


def _check_node(walker: "_Walker", node: memoryview) -> None:
    named = False
    for number, value in walker.messages(node):
        text = bytes(value[:60]).decode("utf-8", "replace")
        if number == _OP_TYPE:
            named = True
            if text not in OPERATORS:
                raise FormatError(f"its operator {text!r} is none of a network's")
        elif number == _DOMAIN and text not in DOMAINS:
            raise FormatError(f"it has an operator of {text!r}, not of ONNX")
        elif number == _ATTRIBUTE:
            _check_attribute(walker, value)
    if not named:
        raise FormatError("it has a node without operator")


def _check_attribute(walker: "_Walker", attribute: memoryview) -> None:
    for number, _ in walker.messages(attribute):
        if number in _REFUSED_ATTRIBUTES:
            raise FormatError(f"it has a node that holds {_REFUSED_ATTRIBUTES[number]}")


class _Walker:
    """Reads messages' fields, at most ``MAX_FIELDS`` of a file."""

    def __init__(self) -> None:
        self._fields = 0

    def messages(self, data: memoryview) -> Iterator[tuple[int, memoryview]]:
        """(Number, content) of a message's length-delimited fields; numbers are passed by."""
        at = 0
        while at < len(data):
            self._fields += 1
            tag, at = _varint(data, at)
            # Parsers differ in what they make of longer tags.
            if self._fields > MAX_FIELDS or tag >= 1 << 32:
                raise FormatError("it is not an ONNX file")
            number, kind = tag >> 3, tag & 7
            if kind == _LENGTH:
                size, at = _varint(data, at)
                if size > len(data) - at:
                    raise FormatError("it is cut short")
                yield number, data[at : at + size]
                at += size
            else:
                at = _skip(data, at, kind)


def _skip(data: memoryview, at: int, kind: int) -> int:
    """Where the field after a number's begins."""
    if kind == _VARINT:
        return _varint(data, at)[1]
    if kind in (_FIXED64, _FIXED32):
        return at + (8 if kind == _FIXED64 else 4)
    raise FormatError("it is not an ONNX file")


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """A number of seven bits a byte, and where the next begins."""
    value = 0
    for i, byte in enumerate(data[at : at + 10]):
        value |= (byte & 127) << 7 * i
        if byte < 128:
            return value, at + i + 1
    raise FormatError("it is cut short")
