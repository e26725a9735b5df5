"""The suit network in torch: architecture, export to ONNX, and loading from that file."""

from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, pixel_shuffle

from annotate.onnx_session import scheme_in_metadata
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from annotate.segmentation.input_channels import FIXED, channel_names, network_input
from annotate.segmentation.suit_network import MAX_BYTES, MULTIPLE, REMEDY, other_person
from eval.architecture.blocks import convolution, self_attention
from eval.network.onnx_export import export_any_size, name_scheme
from eval.network.weights_file import check_fits
from eval.training.expansion import parents_of, start_layer, started
from sensors.errors import FormatError
from sensors.files.atomic import replacing
from sensors.files.bounded import read_bounded

FULL_SUIT_NETWORK, FULL_REFINEMENT_NETWORK = (
    Path(str(files("eval").joinpath("weights", "full", name)))
    for name in ("suit_network.onnx", "refine.onnx")
)
"""The shipped networks in full precision, from which trainings start. Labelling uses quantised ones
(``python -m tools.fit.quantise``)."""
WIDTHS = (20, 32, 64, 96)  # channels at a half, a quarter, an eighth and a sixteenth of the sides; untuned
FINE, JOINED = 24, 32  # channels of four neighbouring pixels, and of the last layer; untuned
HEADS, LAYERS = 4, 2  # of the attention at a sixteenth of the sides; untuned


def inputs_of(scheme: Scheme) -> int:
    """Return the number of the network's inputs in a scheme."""
    planes = np.zeros((len(channel_names(scheme)), 1, 1), np.uint8)
    return len(network_input(planes, len(scheme.parts)))


class SuitNet(nn.Module):
    """Network (B, n, h, w), sides multiples of 16 -> scores (B, K + 1, h, w) of classes and another person.

    A U-Net (Ronneberger et al. 2015) with self-attention at its coarsest level. Its finest level has half of
    the sides: there four scores of each class stand for four pixels.
    """

    def __init__(self, scheme: Scheme = PAPER) -> None:
        super().__init__()
        self.scheme, inputs = scheme, inputs_of(scheme)
        first, deepest = WIDTHS[0], WIDTHS[-1]
        self.enter = convolution(inputs, first, stride=2)
        self.fine = nn.Conv2d(inputs, FINE, 2, 2)
        self.down = nn.ModuleList(
            nn.Sequential(convolution(a, b, stride=2), convolution(b, b)) for a, b in pairwise(WIDTHS)
        )
        self.place = nn.Conv2d(deepest, deepest, 3, padding=1, groups=deepest)
        self.attend = nn.ModuleList(_Attention(deepest) for _ in range(LAYERS))
        self.up = nn.ModuleList(convolution(a + b, a) for a, b in list(pairwise(WIDTHS))[::-1])
        self.join = convolution(first + FINE, JOINED)
        self.leave = nn.Conv2d(JOINED, 4 * (other_person(scheme) + 1), 1)

    def forward(self, image: Tensor) -> Tensor:
        """Return class scores of images (B, C, h, w)."""
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
    """Transformer layer with normalisation before each block; attributes have the names in the shipped
    files.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.before, self.between = nn.LayerNorm(width), nn.LayerNorm(width)
        self.ask, self.answer = _Dense(width, 3 * width), _Dense(width, width)
        self.think = nn.Sequential(_Dense(width, 2 * width), nn.GELU(), _Dense(2 * width, width))

    def forward(self, x: Tensor) -> Tensor:
        x = x + self.answer(self_attention(self.ask(self.before(x)), x.shape, HEADS))
        done: Tensor = x + self.think(self.between(x))
        return done


class _Dense(nn.Module):
    """``nn.Linear`` with its matrix transposed, because an ONNX file stores the matrix so."""

    def __init__(self, width: int, out: int) -> None:
        super().__init__()
        made = nn.Linear(width, out)
        self.weight, self.bias = nn.Parameter(made.weight.detach().T.contiguous()), made.bias

    def forward(self, x: Tensor) -> Tensor:
        return x @ self.weight + self.bias


def export_suit_network(network: SuitNet, path: Path, temperature: float = 1.0) -> None:
    """Write a network as `annotate.segmentation.suit_network` loads it, scores divided by a temperature.

    The file names the scheme. Tensors with equal values, as in an untrained network, are stored only once.
    `load_suit_network` cannot read such a file.
    """
    cool = SuitNet(network.scheme).eval()
    cool.load_state_dict(network.state_dict())
    with torch.no_grad():
        for values in cool.leave.parameters():
            values.div_(temperature)
    with replacing(path) as temporary:
        inputs = inputs_of(network.scheme)
        export_any_size(cool, temporary, inputs, MULTIPLE, ["channels", "scores"])
        name_scheme(temporary, network.scheme)


def load_suit_network(path: Path) -> SuitNet:
    """Load the file of ``export_suit_network``. Raises FormatError where it is not such a file, or is
    quantised.
    """
    import onnx
    from onnx import numpy_helper

    try:
        model = onnx.load_model_from_string(read_bounded(path, MAX_BYTES, REMEDY))
        found = {one.name: torch.tensor(numpy_helper.to_array(one)) for one in model.graph.initializer}
        scheme = scheme_in_metadata({entry.key: entry.value for entry in model.metadata_props})
    except Exception as error:  # protobuf and onnx raise several kinds at damaged bytes
        raise FormatError(f"weights {path} are not an ONNX file; {REMEDY}") from error
    if any(values.dtype == torch.int8 for values in found.values()):
        raise FormatError(f"weights {path} are quantised; give weights in full precision")
    network = SuitNet(scheme or PAPER).eval()
    counts = {name: value for name, value in network.state_dict().items() if value.dtype == torch.int64}
    check_fits(path, network, found | counts)
    network.load_state_dict(found | counts)
    return network


def expanded_suit_network(network: SuitNet, scheme: Scheme) -> SuitNet:
    """Return a network for a scheme's classes and inputs, started from one of another scheme.

    Classes start as in ``eval.training.expansion``. The parts of the previous frame share their parent's
    filter. A part's likelihood has its share of the parent's filter, so that equal likelihoods of the
    children act as the parent's. A thing starts without effect.
    """
    old = network.scheme
    if old == scheme:
        return network
    values, parents = dict(network.state_dict()), parents_of(old, scheme)
    other = [other_person(old)]
    start_layer(values, "leave", [*parents, other], other[0] + 1)
    for name in ("enter.0.weight", "fine.weight"):
        values[name] = _start_inputs(values[name], old, scheme)
    built = SuitNet(scheme)
    built.load_state_dict(values)
    return built.train(network.training)


def _start_inputs(filters: Tensor, old: Scheme, new: Scheme) -> Tensor:
    """Return filters (c, n, h, w) for the inputs of a new scheme: flags, parts, other channels,
    likelihoods.
    """
    parents = parents_of(old, new)
    of_likelihoods = len(old.body_classes)
    likelihoods, rest = filters[:, filters.shape[1] - of_likelihoods :], filters[:, :-of_likelihoods]
    start = rest.shape[1] - len(FIXED) + 2 - len(old.parts)  # after the flags
    stop = start + len(old.parts)
    flags, before, others = rest[:, :start], rest[:, start:stop], rest[:, stop:]
    # The background has no plane.
    known = torch.cat([torch.zeros_like(before[:, :1]), before], dim=1).transpose(0, 1)
    body = old.body_classes.tolist()
    of_body = [[body.index(i) for i in parents[k]] for k in new.body_classes.tolist()]
    children = torch.tensor([float(max(1, sum(i in one for one in of_body))) for i in range(len(body))])
    shared = (likelihoods / children.reshape(1, -1, 1, 1).to(likelihoods)).transpose(0, 1)
    summed = torch.stack([shared[one].sum(dim=0) for one in of_body])
    return torch.cat(
        [flags, started(known, parents[1:]).transpose(0, 1), others, summed.transpose(0, 1)], dim=1
    )
