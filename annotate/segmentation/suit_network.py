"""Suit segmentation network: a small U-Net that labels every pixel with its part.

Its training: `annotate/segmentation/suit_network.md`.
"""

import hashlib
from collections.abc import Sequence
from functools import cache, cached_property
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
from numba import njit

from annotate.array_types import Float32, Index, UInt8
from annotate.onnx_graph import without_channels
from annotate.onnx_session import onnx_session, scheme_in_metadata
from annotate.parts import PAPER
from annotate.scheme.merging import converts
from annotate.scheme.scheme import Scheme
from annotate.scheme_network import SchemeNetwork
from annotate.segmentation.depth_inputs import depth_input, inputs_by_depth, is_depth_alone
from annotate.segmentation.input_channels import FIXED, Rectangle, fitted_to, network_input
from annotate.segmentation.split_network import INPUT, PLACE, SHUFFLE, split_network
from annotate.suit.palette import Suit, divides
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

MULTIPLE = 16  # sides are padded to multiples, because the network halves an image four times
MAX_BYTES = 1 << 26  # of a weights file
SHIPPED_SUIT_NETWORK = Path(str(files("annotate").joinpath("segmentation", "suit_network.onnx")))
REMEDY = "give a file that `annotate-cloud train-labels` wrote"
"""End of the messages about an invalid weights file."""


def other_person(scheme: Scheme) -> int:
    """Return a network's class of another person, which follows the classes of a scheme."""
    return len(scheme.class_ids)


class SuitNetwork(SchemeNetwork):
    """Trained suit segmentation network. sha256: hash of its file. Several threads may call it.

    own: scheme of the network's classes and inputs, named in the file or ``paper``. scheme: of the
    probabilities, ``own`` or by ``in_scheme``. Raises FormatError for a file of another network.
    """

    def __init__(self, path: Path) -> None:
        file = read_bounded(path, MAX_BYTES, REMEDY)
        try:
            self._load(file)
            for byte in (np.uint8(0), np.uint8(255)):  # without colour and temperature, and with
                self.probabilities(np.full((len(FIXED), MULTIPLE, 2 * MULTIPLE), byte), 1)
        except SystemError:  # Numba's, interrupted
            raise
        except Exception as error:  # ONNX Runtime's own errors share no public base
            raise FormatError(f"weights {path} do not belong to a suit network; {REMEDY}") from error

    def __getstate__(self) -> tuple[bytes, Scheme]:
        # A loaded network cannot be pickled.
        return self._file, self.scheme

    def __setstate__(self, state: tuple[bytes, Scheme]) -> None:
        file, scheme = state
        self._load(file)
        self.scheme = scheme

    def for_suit(self, suit: Suit | None) -> "SuitNetwork":
        """Return the network with labels in the suit's scheme, or in the usual scheme without a suit.

        Colours divide classes that lie in several parts of the suit. The usual scheme is kept if such a part
        has no colour of its own, or if the suit's parts only join classes. It is also kept if the network
        has the suit's parts and more things.
        """
        if suit is None:
            return self.in_scheme(self.usual_scheme)
        if self.own.is_of_regions:
            return self.in_scheme(suit.scheme)
        joins, same = converts(self.own, suit.scheme), converts(suit.scheme, self.own)
        usual = joins and (not same or self.own.things > suit.scheme.things)
        if usual or not divides(suit, self.own):
            return self.in_scheme(self.usual_scheme)
        return self.labelling(suit.scheme)

    def _load(self, file: bytes) -> None:
        self._file, self.sha256 = file, hashlib.sha256(file).hexdigest()
        self._all_inputs = _Halves(file)
        metadata = self._all_inputs.around.get_modelmeta().custom_metadata_map
        self.own = self.scheme = scheme_in_metadata(metadata) or PAPER

    @cached_property
    def _depth_inputs(self) -> "_Halves":
        """Return the network without inputs of colour and temperature."""
        try:
            return _Halves(self._file, inputs_by_depth(len(self.own.parts)))
        except ValueError:  # other layers than convolutions read the inputs
            return self._all_inputs

    def _halves(self, planes: UInt8) -> "_Halves":
        """Return the smallest network that reads all known values of channels (n, h, w)."""
        return self._depth_inputs if is_depth_alone(planes) else self._all_inputs

    def probabilities(self, planes: UInt8, step: int, near: Rectangle | None = None) -> Float32:
        """Return class probabilities (K + 1, h, w), another person's last, of the rectangle ``near`` of
        channels (n, h', w'). near: None = all.

        Likelihoods in another number than the own scheme's are taken as unknown. The network runs on the
        images of every ``step``-th pixel, which together hold all pixels. Context features are computed for
        one image only, and interpolated for the others.
        """
        near = near or Rectangle(*(slice(0, side) for side in planes.shape[1:]))
        planes = fitted_to(planes, self.own)
        halves, place = self._halves(planes), PLACE * step
        sides = [slice(own.start // place, -(-own.stop // place)) for own in near]
        around = np.pad(self._of_all(halves, planes[:, ::step, ::step]), ((0, 0), (0, 1), (0, 1)), "edge")
        around = around[:, *(slice(own.start, own.stop + 1) for own in sides)]
        height, width = ((side.stop - side.start) * place for side in sides)
        seen = planes[:, *(slice(side.start * place, side.stop * place) for side in sides)]
        own = np.zeros((len(planes), height, width), np.uint8)
        found = np.empty((other_person(self.own) + 1, height, width), np.float32)
        own[:, : seen.shape[1], : seen.shape[2]] = seen
        for top in range(step):
            for left in range(step):
                moved = _between(around, top / place, left / place)
                scores = self._of_own(halves, own[:, top::step, left::step], moved)
                _softmax(scores, found[:, top::step, left::step])
        inner = (slice(own.start % place, own.start % place + own.stop - own.start) for own in near)
        return self.merged(found[:, *inner])

    def _input(self, halves: "_Halves", planes: UInt8) -> Float32:
        made = network_input if halves.inputs is None else depth_input
        return made(planes, len(self.own.parts))[None]

    def _of_all(self, halves: "_Halves", planes: UInt8) -> Float32:
        """Return the encoder's features (k, h / 4, w / 4) of a whole image, padded at the end."""
        count, height, width = planes.shape
        padded = np.zeros((count, height + -height % MULTIPLE, width + -width % MULTIPLE), np.uint8)
        padded[:, :height, :width] = planes
        found: Float32 = halves.around.run(None, {INPUT: self._input(halves, padded)})[0][0]
        return found

    def _of_own(self, halves: "_Halves", planes: UInt8, around: Float32) -> Float32:
        """Return the decoder's scores (K + 1, 2, 2, h / 2, w / 2) for channels (n, h, w): of each class, rows
        and columns of a cell, then of cells.

        around: features (k, h / 4, w / 4).
        """
        given = {INPUT: self._input(halves, planes), halves.context: around[None]}
        scores: Float32 = halves.fine.run(None, given)[0][0]
        count, (height, width) = other_person(self.own) + 1, planes.shape[1:]
        if scores.shape == (count, height, width):
            cells = scores.reshape(count, height // SHUFFLE, SHUFFLE, width // SHUFFLE, SHUFFLE)
            return np.ascontiguousarray(cells.transpose(0, 2, 4, 1, 3))
        if scores.shape != (count * SHUFFLE**2, height // SHUFFLE, width // SHUFFLE):
            raise ValueError(f"scores of shape {scores.shape}")
        return scores.reshape(count, SHUFFLE, SHUFFLE, *scores.shape[1:])


class _Halves:
    """Loaded halves of a network: encoder, decoder, and the name of the features between them.

    inputs: the only ones that the halves read, the others count as 0; None = all. Raises ValueError as
    ``without_channels`` and ``split_network``.
    """

    def __init__(self, file: bytes, inputs: Sequence[int] | None = None) -> None:
        self.inputs = inputs
        file = file if inputs is None else without_channels(file, INPUT, inputs)
        first, second, self.context = split_network(file)
        self.around, self.fine = onnx_session(first), onnx_session(second)


@cache
def shipped_suit_network() -> SuitNetwork:
    """Load the network that the package contains, once."""
    return SuitNetwork(SHIPPED_SUIT_NETWORK)


def flipped(planes: UInt8, scheme: Scheme = PAPER) -> UInt8:
    """Flip channels (n, h, w) of a scheme left to right; swap left and right in labels and likelihoods."""
    tall = np.ascontiguousarray(planes).reshape(-1, planes.shape[2])
    turned = np.asarray(cv2.flip(tall, 1), np.uint8).reshape(planes.shape)
    before, of_parts = FIXED.index("before"), slice(len(FIXED), None)
    turned[before] = swap_classes(turned[before], scheme)
    body, twins = scheme.body_classes, scheme.twin_classes
    turned[of_parts] = turned[of_parts][np.searchsorted(body, twins[body])]
    return turned


def swap_classes(classes: UInt8, scheme: Scheme) -> UInt8:
    """Exchange left and right in classes uint8 of any shape; another person and unknown ones stay."""
    table = np.arange(256, dtype=np.uint8)
    table[: len(scheme.twin_classes)] = scheme.twin_classes
    return table[classes]


def flip_averaged(network: SuitNetwork, planes: UInt8, step: int, near: Rectangle) -> Float32:
    """Return the mean probabilities (K + 1, h, w) of channels and of their flipped copy (docs/adr/0026)."""
    # Context is sampled every ``step`` columns; the padding makes a flip keep the phase.
    planes = fitted_to(planes, network.own)
    if more := (1 - planes.shape[2]) % step:
        planes = np.pad(planes, ((0, 0), (0, 0), (0, more)))
    left, right = (planes.shape[2] - end for end in (near.columns.stop, near.columns.start))
    there = Rectangle(near.rows, slice(left, right))
    twins = np.append(network.scheme.twin_classes, other_person(network.scheme)).astype(np.intp)
    other = network.probabilities(flipped(planes, network.own), step, there)
    return mean_with_flip(network.probabilities(planes, step, near), other, twins)


@njit(cache=True, nogil=True)
def mean_with_flip(own: Float32, other: Float32, twins: Index) -> Float32:
    """Return the mean (K, h, w) of planes for an image and for its flip. twins: (K,), twin of each plane."""
    mean, half = np.empty(own.shape, np.float32), np.float32(0.5)
    for k in range(own.shape[0]):
        for v in range(own.shape[1]):
            turned = other[twins[k], v, ::-1]
            for u in range(turned.size):
                mean[k, v, u] = half * (own[k, v, u] + turned[u])
    return mean


def _between(around: Float32, down: float, right: float) -> Float32:
    """Return features (k, h, w) interpolated from (k, h + 1, w + 1). down, right: shares of a cell's side."""
    rows = around[:, :-1] + np.float32(down) * (around[:, 1:] - around[:, :-1])
    return np.ascontiguousarray(rows[..., :-1] + np.float32(right) * (rows[..., 1:] - rows[..., :-1]))


def _softmax(scores: Float32, chance: Float32) -> None:
    """Write the softmax over k of scores (k, 2, 2, h, w), of cells, into ``chance`` (k, 2 h, 2 w); the scores
    are overwritten.
    """
    _lower(scores.reshape(len(scores), -1, scores.shape[-1]))
    _share(np.exp(scores, out=scores), chance)


@njit(cache=True, nogil=True)
def _lower(scores: Float32) -> None:
    """Subtract from scores (k, h, w) the largest of each pixel."""
    most = np.empty(scores.shape[2], np.float32)
    for v in range(scores.shape[1]):
        most[:] = scores[0, v]
        for k in range(1, scores.shape[0]):
            for u in range(most.size):
                most[u] = max(most[u], scores[k, v, u])
        for k in range(scores.shape[0]):
            for u in range(most.size):
                scores[k, v, u] -= most[u]


@njit(cache=True, nogil=True)
def _share(odds: Float32, chance: Float32) -> None:
    """Write odds (k, 2, 2, h, w) of cells, divided by their sum over k, into ``chance`` (k, 2 h, 2 w)."""
    count, rows, columns, height, width = odds.shape
    total, share = np.empty(width, np.float32), np.empty(width, np.float32)
    row = np.empty((count, columns * width), np.float32)
    for v in range(height * rows):
        for right in range(columns):
            total[:] = odds[0, v % rows, right, v // rows]
            for k in range(1, count):
                for u in range(width):
                    total[u] += odds[k, v % rows, right, v // rows, u]
            for k in range(count):
                for u in range(width):  # apart from the scattered writing, so that the division vectorises
                    share[u] = odds[k, v % rows, right, v // rows, u] / total[u]
                for u in range(width):
                    row[k, u * columns + right] = share[u]
        for k in range(count):
            for u in range(columns * width):
                chance[k, v, u] = row[k, u]
