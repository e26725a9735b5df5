"""ONNX file of a network that takes images of any size, from which a training can go on."""

import warnings
from pathlib import Path

import torch
from torch import nn


def export_any_size(
    network: nn.Module, channels: int, multiple: int, path: Path, given: str, answer: str
) -> None:
    """Write a network of one image (1, channels, h, w), sides multiples of ``multiple``, in evaluation mode.

    given, answer: names of its input and its output.
    """
    sides = {2: "h", 3: "w"}
    with warnings.catch_warnings():
        # The other exporter needs onnxscript; the number of images, which is 1, is the only thing traced.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network.eval(),
            (torch.zeros(1, channels, 2 * multiple, 3 * multiple),),
            str(path),
            opset_version=17,
            dynamo=False,
            # Leaves the layers' statistics apart from their weights: a training goes on with both.
            training=torch.onnx.TrainingMode.PRESERVE,
            input_names=[given],
            output_names=[answer],
            dynamic_axes={given: sides, answer: sides},
        )
