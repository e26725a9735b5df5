"""Quantise a suit network's convolutions: ``python -m tools.fit.quantise FULL OUT EXAMPLES...``.

FULL, OUT: weights (.onnx). EXAMPLES: files of its training's examples. The result takes a third of the time
on processors with such instructions. Weights have seven bits, because sums would overflow on older
processors. Source: Jacob et al. 2018, quantisation after training.
"""

import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import onnx
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process

from annotate.array_types import Float32
from annotate.parts import PAPER
from annotate.segmentation.input_channels import network_input
from annotate.segmentation.segment import SAMPLE_M
from annotate.segmentation.split_network import INPUT
from eval.training.segmentation.augmentation import sample_as_labelled
from eval.training.segmentation.examples import ExampleFiles
from sensors.files.atomic import replacing

CALIBRATED_ON = 96  # inputs that give the ranges; untuned
EXACT = ("leave",)  # layers in full precision: the last, which decides
QUANTISED = ("Conv", "MatMul")  # kinds of nodes of convolutions and linear layers
Inputs = dict[str, Float32]


class _Inputs(CalibrationDataReader):  # type: ignore[misc]
    def __init__(self, inputs: Iterable[Inputs]) -> None:
        self._left: Iterator[Inputs] = iter(inputs)

    def get_next(self) -> Inputs | None:
        return next(self._left, None)


def quantise(
    source: Path, inputs: Iterable[Inputs], out: Path, exact: Sequence[str], linear: Sequence[str] = ()
) -> None:
    """Write the network of an ONNX file with quantised convolutions.

    inputs: arrays by the network's input names, for the ranges. exact: names of convolutions in full
    precision. linear: names of linear layers that are quantised too. Raises ValueError where a named layer is
    missing.
    """
    with TemporaryDirectory() as folder, replacing(out) as unfinished:
        whole = Path(folder) / "whole.onnx"
        quant_pre_process(source, whole, skip_symbolic_shape=True)
        nodes = onnx.load(whole).graph.node
        convolutions, products = ([n.name for n in nodes if n.op_type == kind] for kind in QUANTISED)
        kept, chosen = _named(convolutions, exact), _named(products, linear)
        quantize_static(
            whole,
            unfinished,
            _Inputs(inputs),
            quant_format=QuantFormat.QDQ,
            op_types_to_quantize=list(QUANTISED),
            nodes_to_exclude=[*kept, *(name for name in products if name not in chosen)],
            per_channel=True,
            reduce_range=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
        )
        onnx.checker.check_model(onnx.load(unfinished))


def _named(nodes: Sequence[str], layers: Sequence[str]) -> list[str]:
    """Return the names of the nodes of layers. Raises ValueError for a layer without nodes."""
    if missing := [layer for layer in layers if not any(f"/{layer}/" in name for name in nodes)]:
        raise ValueError(f"the network has no layers {missing}")
    return [name for name in nodes if any(f"/{layer}/" in name for layer in layers)]


def main() -> None:
    """Quantise a suit network."""
    full, out, *paths = map(Path, sys.argv[1:])
    examples = ExampleFiles(paths)
    samples = (sample_as_labelled(examples[i], SAMPLE_M) for i in examples.spread(CALIBRATED_ON))
    quantise(
        full,
        ({INPUT: network_input(sample.planes, len(PAPER.parts))[None]} for sample in samples),
        out,
        EXACT,
    )


if __name__ == "__main__":
    main()
