"""The reader of suits: a small U-Net that names every pixel's part from the channels of a frame.

How it was trained: `annotate/segmentation/suit_network.md`.
"""

import hashlib
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np

from annotate.array_types import Float32, UInt8
from annotate.onnx_session import onnx_session
from annotate.parts import N_CLASSES
from annotate.segmentation.input_channels import CHANNELS, Rectangle, network_input
from annotate.segmentation.split_network import INPUT, PLACE, halves
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

CLASSES = N_CLASSES + 1
"""The parts, the background first, and another person last."""
MULTIPLE = 16
"""The network halves an image four times: its sides are padded to multiples of this."""
MAX_BYTES = 1 << 26
"""Largest file of weights that is read; the shipped one has 1.0 MB, in full precision 2.1."""
SHIPPED_READER = Path(str(files("annotate").joinpath("segmentation", "suit_network.onnx")))
"""The reader that comes with the package."""
REMEDY = "give a file that `annotate-cloud train-labels` wrote"
"""End of the messages about a file that is no reader."""


class Reader:
    """A trained network. sha256: of its file. Several threads may call it at once.

    Raises FormatError where the file is no network for these channels.
    """

    def __init__(self, path: Path) -> None:
        file = read_bounded(path, MAX_BYTES, REMEDY)
        try:
            self.__setstate__(file)
            self.probabilities(np.zeros((len(CHANNELS), MULTIPLE, 2 * MULTIPLE), np.uint8), 1)
        except SystemError:  # Numba's, interrupted
            raise
        except Exception as error:  # ONNX Runtime's own errors share no public base
            raise FormatError(f"weights {path} are no network for labels; {REMEDY}") from error

    def __getstate__(self) -> bytes:
        """The file, since a loaded network cannot be sent to another process."""
        return self._file

    def __setstate__(self, file: bytes) -> None:
        """Load the network from its file."""
        self._file, self.sha256 = file, hashlib.sha256(file).hexdigest()
        first, second, self._context = halves(file)
        self._around, self._fine = onnx_session(first), onnx_session(second)

    def probabilities(self, planes: UInt8, step: int, near: Rectangle | None = None) -> Float32:
        """Probabilities (13, h, w) of the classes from channels (24, h', w'); near: (h, w) of these, or all.

        The network sees images of every ``step``-th pixel; each pixel is in one of them, with its own depth,
        colour and temperature. What is around is seen in one image alone, and moved for the others.
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
        """What the first half says of an image's places (k, h / 4, w / 4), some more at the ends."""
        height, width = planes.shape[1:]
        padded = np.pad(planes, ((0, 0), (0, -height % MULTIPLE), (0, -width % MULTIPLE)))
        found: Float32 = self._around.run(None, {INPUT: network_input(padded)[None]})[0][0]
        return found

    def _of_own(self, planes: UInt8, around: Float32) -> Float32:
        """Scores (13, h, w) by channels (24, h, w), and what is around (k, h / 4, w / 4)."""
        given = {INPUT: network_input(planes)[None], self._context: around[None]}
        scores: Float32 = self._fine.run(None, given)[0][0]
        if scores.shape != (CLASSES, *planes.shape[1:]):
            raise ValueError(f"scores of shape {scores.shape}")
        return scores


@cache
def shipped_reader() -> Reader:
    """The reader that comes with the package."""
    return Reader(SHIPPED_READER)


def _between(around: Float32, down: float, right: float) -> Float32:
    """Values (k, h, w) between places (k, h + 1, w + 1), shares of a place's side further down and right."""
    rows = around[:, :-1] + np.float32(down) * (around[:, 1:] - around[:, :-1])
    return np.ascontiguousarray(rows[..., :-1] + np.float32(right) * (rows[..., 1:] - rows[..., :-1]))


def _softmax(scores: Float32) -> Float32:
    """Probabilities (k, h, w) from log scores."""
    raised = np.exp(scores - scores.max(axis=0))
    return np.asarray(raised / raised.sum(axis=0), np.float32)
