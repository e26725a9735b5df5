"""The reader of suits in torch, and its file: it stores the tensors of the network, so that it reads back."""

from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, pixel_shuffle

from annotate.segmentation.input_channels import CHANNELS, network_input
from annotate.segmentation.suit_network import CLASSES, MAX_BYTES, MULTIPLE, REMEDY
from eval.network.checkpoint import check_fits
from eval.training.onnx_file import export_any_size
from sensors.errors import FormatError
from sensors.files.atomic import replacing
from sensors.files.bounded import read_bounded

FULL_READER, FULL_AGAIN = (
    Path(str(files("eval").joinpath("weights", "full", name)))
    for name in ("suit_network.onnx", "refine.onnx")
)
"""The shipped readers in full precision: trainings go on from them. Those that label compute in eight bits
(``python -m tools.fit.quantise``)."""
INPUTS = len(network_input(np.zeros((len(CHANNELS), 1, 1), np.uint8)))
"""Channels of the network's input."""
WIDTHS = (20, 32, 64, 96)
"""Channels at a half, a quarter, an eighth and a sixteenth of the image's sides. Chosen by eye."""
FINE, JOINED = 24, 32
"""Channels of what four neighbouring pixels show, and of the last layer. Chosen by eye."""
HEADS, LAYERS = 4, 2
"""Of the attention at a sixteenth of the sides, where every place sees all others. Chosen by eye."""


class ReaderNet(nn.Module):
    """Inputs (B, 38, h, w), sides multiples of 16 -> scores (B, 13, h, w), of the parts and another person.

    A U-Net (Ronneberger et al. 2015) with self-attention (Vaswani et al. 2017) where it is coarsest. Half of
    the sides is its finest level: there four scores of each class stand for four pixels.
    """

    def __init__(self) -> None:
        super().__init__()
        first, deepest = WIDTHS[0], WIDTHS[-1]
        self.enter = _layer(INPUTS, first, 2)
        self.fine = nn.Conv2d(INPUTS, FINE, 2, 2)
        self.down = nn.ModuleList(nn.Sequential(_layer(a, b, 2), _layer(b, b)) for a, b in pairwise(WIDTHS))
        self.place = nn.Conv2d(deepest, deepest, 3, padding=1, groups=deepest)
        self.attend = nn.ModuleList(_Attention(deepest) for _ in range(LAYERS))
        self.up = nn.ModuleList(_layer(a + b, a) for a, b in list(pairwise(WIDTHS))[::-1])
        self.join = _layer(first + FINE, JOINED)
        self.leave = nn.Conv2d(JOINED, 4 * CLASSES, 1)

    def forward(self, image: Tensor) -> Tensor:
        """Scores of images."""
        fine, x, kept = self.fine(image), self.enter(image), []
        for down in self.down:
            kept.append(x)
            x = down(x)
        x = x + self.place(x)
        places = x.reshape(len(x), WIDTHS[-1], -1).transpose(1, 2)
        for attend in self.attend:
            places = attend(places)
        x = places.transpose(1, 2).reshape(x.shape)
        for up in self.up:
            x = up(torch.cat([interpolate(x, scale_factor=2.0, mode="nearest"), kept.pop()], dim=1))
        return pixel_shuffle(self.leave(self.join(torch.cat([x, fine], dim=1))), 2)


class _Attention(nn.Module):
    """Every place's features (B, n, w) with those of all others."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.before, self.between = nn.LayerNorm(width), nn.LayerNorm(width)
        self.ask, self.answer = _Dense(width, 3 * width), _Dense(width, width)
        self.think = nn.Sequential(_Dense(width, 2 * width), nn.GELU(), _Dense(2 * width, width))

    def forward(self, x: Tensor) -> Tensor:
        width = WIDTHS[-1]
        asked = self.ask(self.before(x)).chunk(3, dim=-1)
        query, key, value = (t.reshape(len(x), -1, HEADS, width // HEADS).transpose(1, 2) for t in asked)
        weight = torch.softmax(query @ key.transpose(2, 3) / (width // HEADS) ** 0.5, dim=-1)
        x = x + self.answer((weight @ value).transpose(1, 2).reshape(len(x), -1, width))
        done: Tensor = x + self.think(self.between(x))
        return done


class _Dense(nn.Module):
    """``nn.Linear`` with its matrix the other way: as a file stores it, so that it keeps its name there."""

    def __init__(self, width: int, out: int) -> None:
        super().__init__()
        made = nn.Linear(width, out)
        self.weight, self.bias = nn.Parameter(made.weight.detach().T.contiguous()), made.bias

    def forward(self, x: Tensor) -> Tensor:
        return x @ self.weight + self.bias


def _layer(channels: int, out: int, stride: int = 1) -> nn.Sequential:
    convolution = nn.Conv2d(channels, out, 3, stride, 1, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(out), nn.ReLU(inplace=True))


def export_reader(network: ReaderNet, path: Path, temperature: float = 1.0) -> None:
    """Write a network as `annotate.segmentation.suit_network` reads it, its scores divided by a temperature.

    Of tensors that are equal, as those of an untrained network may be, the file has one: it reads not back.
    """
    cool = ReaderNet().eval()
    cool.load_state_dict(network.state_dict())
    with torch.no_grad():
        for values in cool.leave.parameters():
            values.div_(temperature)
    with replacing(path) as temporary:
        export_any_size(cool, INPUTS, MULTIPLE, temporary, "channels", "scores")


def load_reader(path: Path) -> ReaderNet:
    """The network that ``export_reader`` wrote. Raises FormatError for another file."""
    import onnx
    from onnx import numpy_helper

    network = ReaderNet().eval()
    try:
        stored = onnx.load_model_from_string(read_bounded(path, MAX_BYTES, REMEDY)).graph.initializer
        found = {tensor.name: torch.tensor(numpy_helper.to_array(tensor)) for tensor in stored}
    except Exception as error:  # protobuf and onnx raise several kinds at damaged bytes
        raise FormatError(f"weights {path} are no ONNX file; {REMEDY}") from error
    if any(values.dtype == torch.int8 for values in found.values()):
        raise FormatError(f"weights {path} compute in eight bits; give those in full precision")
    counts = {name: value for name, value in network.state_dict().items() if value.dtype == torch.int64}
    check_fits(path, network, found | counts)
    network.load_state_dict(found | counts)
    return network
