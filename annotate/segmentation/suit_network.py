"""Suit segmentation network: a small U-Net that labels every pixel with its part.

Its training: `annotate/segmentation/suit_network.md`.
"""

import hashlib
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np

from annotate.array_types import Float32, UInt8
from annotate.onnx_session import onnx_session
from annotate.parts import N_CLASSES, TWIN_PARTS, swap_left_right
from annotate.segmentation.input_channels import CHANNELS, Rectangle, network_input
from annotate.segmentation.split_network import INPUT, PLACE, split_network
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

CLASSES = N_CLASSES + 1
"""The parts, the background first, and another person last."""
MULTIPLE = 16  # sides are padded to multiples, because the network halves an image four times
MAX_BYTES = 1 << 26  # of a weights file
SHIPPED_SUIT_NETWORK = Path(str(files("annotate").joinpath("segmentation", "suit_network.onnx")))
REMEDY = "give a file that `annotate-cloud train-labels` wrote"
"""End of the messages about an invalid weights file."""


class SuitNetwork:
    """Trained suit segmentation network. sha256: hash of its file. Several threads may call it.

    Raises FormatError for a file of another network.
    """

    def __init__(self, path: Path) -> None:
        file = read_bounded(path, MAX_BYTES, REMEDY)
        try:
            self.__setstate__(file)
            self.probabilities(np.zeros((len(CHANNELS), MULTIPLE, 2 * MULTIPLE), np.uint8), 1)
        except SystemError:  # Numba's, interrupted
            raise
        except Exception as error:  # ONNX Runtime's own errors share no public base
            raise FormatError(f"weights {path} do not belong to a suit network; {REMEDY}") from error

    def __getstate__(self) -> bytes:
        # A loaded network cannot be pickled.
        return self._file

    def __setstate__(self, file: bytes) -> None:
        self._file, self.sha256 = file, hashlib.sha256(file).hexdigest()
        first, second, self._context = split_network(file)
        self._around, self._fine = onnx_session(first), onnx_session(second)

    def probabilities(self, planes: UInt8, step: int, near: Rectangle | None = None) -> Float32:
        """Return class probabilities (13, h, w) of the rectangle ``near`` of channels (24, h', w'). near:
        None = all.

        The network runs on the images of every ``step``-th pixel, which together hold all pixels. Context
        features are computed for one image only, and interpolated for the others.
        """
        near = near or Rectangle(*(slice(0, side) for side in planes.shape[1:]))
        place = PLACE * step
        sides = [slice(own.start // place, -(-own.stop // place)) for own in near]
        around = np.pad(self._of_all(planes[:, ::step, ::step]), ((0, 0), (0, 1), (0, 1)), "edge")
        around = around[:, *(slice(own.start, own.stop + 1) for own in sides)]
        height, width = ((side.stop - side.start) * place for side in sides)
        seen = planes[:, *(slice(side.start * place, side.stop * place) for side in sides)]
        own = np.zeros((len(planes), height, width), np.uint8)
        found = np.empty((CLASSES, height, width), np.float32)
        own[:, : seen.shape[1], : seen.shape[2]] = seen
        for top in range(step):
            for left in range(step):
                moved = _between(around, top / place, left / place)
                found[:, top::step, left::step] = self._of_own(own[:, top::step, left::step], moved)
        inner = (slice(own.start % place, own.start % place + own.stop - own.start) for own in near)
        return _softmax(found[:, *inner])

    def _of_all(self, planes: UInt8) -> Float32:
        """Return the encoder's features (k, h / 4, w / 4) of a whole image, padded at the end."""
        height, width = planes.shape[1:]
        padded = np.pad(planes, ((0, 0), (0, -height % MULTIPLE), (0, -width % MULTIPLE)))
        found: Float32 = self._around.run(None, {INPUT: network_input(padded)[None]})[0][0]
        return found

    def _of_own(self, planes: UInt8, around: Float32) -> Float32:
        """Return the decoder's scores (13, h, w) for channels (24, h, w). around: features (k, h /
        4, w / 4).
        """
        given = {INPUT: network_input(planes)[None], self._context: around[None]}
        scores: Float32 = self._fine.run(None, given)[0][0]
        if scores.shape != (CLASSES, *planes.shape[1:]):
            raise ValueError(f"scores of shape {scores.shape}")
        return scores


@cache
def shipped_suit_network() -> SuitNetwork:
    """Load the network that the package contains, once."""
    return SuitNetwork(SHIPPED_SUIT_NETWORK)


def flipped(planes: UInt8) -> UInt8:
    """Flip channels (24, h, w) left to right; swap left and right parts in labels and likelihoods."""
    turned = planes[:, :, ::-1].copy()
    before, of_parts = CHANNELS.index("before"), slice(1 - N_CLASSES, None)
    turned[before] = swap_left_right(turned[before])
    turned[of_parts] = turned[of_parts][TWIN_PARTS[1:] - 1]
    return turned


def flip_averaged(network: SuitNetwork, planes: UInt8, step: int, near: Rectangle) -> Float32:
    """Return the mean probabilities (13, h, w) of channels and of their flipped copy (docs/adr/0026)."""
    # Context is sampled every ``step`` columns; the padding makes a flip keep the phase.
    if more := (1 - planes.shape[2]) % step:
        planes = np.pad(planes, ((0, 0), (0, 0), (0, more)))
    left, right = (planes.shape[2] - end for end in (near.columns.stop, near.columns.start))
    there = Rectangle(near.rows, slice(left, right))
    other = network.probabilities(flipped(planes), step, there)[np.append(TWIN_PARTS, N_CLASSES), :, ::-1]
    return np.float32(0.5) * (network.probabilities(planes, step, near) + other)


def _between(around: Float32, down: float, right: float) -> Float32:
    """Return features (k, h, w) interpolated from (k, h + 1, w + 1). down, right: shares of a cell's side."""
    rows = around[:, :-1] + np.float32(down) * (around[:, 1:] - around[:, :-1])
    return np.ascontiguousarray(rows[..., :-1] + np.float32(right) * (rows[..., 1:] - rows[..., :-1]))


def _softmax(scores: Float32) -> Float32:
    raised = np.exp(scores - scores.max(axis=0))
    return np.asarray(raised / raised.sum(axis=0), np.float32)
