"""A reader whose convolutions compute in eight bits: ``python -m tools.fit.quantise FULL OUT EXAMPLES...``.

FULL, OUT: weights (.onnx). EXAMPLES: files of its training's examples. It takes a third of the time where a
processor has such instructions; weights have one bit less, so that no sum overflows where it lacks the
newest. Source: Jacob et al. 2018, after training; ranges of what layers give are those over some inputs.
"""

import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import onnx
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process

from annotate.array_types import Float32
from annotate.segmentation.input_channels import network_input
from annotate.segmentation.segment import SAMPLE_M
from annotate.segmentation.split_network import INPUT
from eval.training.segmentation.augmentation import as_labelling
from eval.training.segmentation.examples import Stock
from sensors.files.atomic import replacing

SEEN = 96
"""Inputs that the ranges are taken from. Chosen by eye."""
EXACT = ("leave",)
"""Layers that stay in full precision: the last, which decides."""
Inputs = dict[str, Float32]
"""Arrays by the names of a network's inputs."""


class _Seen(CalibrationDataReader):  # type: ignore[misc]
    def __init__(self, inputs: Iterable[Inputs]) -> None:
        self._left: Iterator[Inputs] = iter(inputs)

    def get_next(self) -> Inputs | None:
        return next(self._left, None)


def eight_bits(source: Path, inputs: Iterable[Inputs], out: Path, exact: Sequence[str]) -> None:
    """Write the network of an ONNX file with convolutions in eight bits.

    inputs: those that ranges are taken from. exact: names of layers that stay in full precision. Raises
    ValueError where one of these is missing.
    """
    with TemporaryDirectory() as folder, replacing(out) as unfinished:
        whole = Path(folder) / "whole.onnx"
        quant_pre_process(source, whole, skip_symbolic_shape=True)
        names = [node.name for node in onnx.load(whole).graph.node if node.op_type == "Conv"]
        if missing := [layer for layer in exact if not any(f"/{layer}/" in name for name in names)]:
            raise ValueError(f"{source} has no layers {missing}")
        kept = [name for name in names if any(f"/{layer}/" in name for layer in exact)]
        quantize_static(
            whole,
            unfinished,
            _Seen(inputs),
            quant_format=QuantFormat.QDQ,
            op_types_to_quantize=["Conv"],
            nodes_to_exclude=kept,
            per_channel=True,
            reduce_range=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
        )
        onnx.checker.check_model(onnx.load(unfinished))


def main() -> None:
    """Convert."""
    full, out, *examples = map(Path, sys.argv[1:])
    stock = Stock(examples)
    seen = (as_labelling(stock[i], SAMPLE_M).planes for i in stock.spread(SEEN))
    eight_bits(full, ({INPUT: network_input(planes)[None]} for planes in seen), out, EXACT)


if __name__ == "__main__":
    main()
