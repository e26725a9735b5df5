"""The reader of suits: a small U-Net that names every pixel's part from the channels of a frame.

How it was trained: `annotate/reader/reader.md`.
"""

import hashlib
import threading
from functools import cache
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np

from annotate.array_types import Float32, UInt8
from annotate.parts import N_CLASSES
from annotate.reader.channels import CHANNELS, network_input
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

CLASSES = N_CLASSES + 1
"""The parts, the background first, and another person last."""
MULTIPLE = 16
"""The network halves an image four times: its sides are padded to multiples of this."""
MOST_BYTES = 1 << 26
"""Largest file of weights that is read; the shipped one has 1.5 MB."""
SHIPPED_READER = Path(str(files("annotate").joinpath("reader", "reader.onnx")))
REMEDY = "give a file that `annotate-cloud train-labels` wrote"


class Reader:
    """A trained network. sha256: of its file. Safe to call from several threads: they take turns.

    Raises FormatError where the file is no network for these channels.
    """

    def __init__(self, path: Path) -> None:
        try:
            self.__setstate__(read_bounded(path, MOST_BYTES, REMEDY))
            trial = self._scores(np.zeros((len(CHANNELS), MULTIPLE, 2 * MULTIPLE), np.uint8))
        except cv2.error as error:
            raise FormatError(f"weights {path} are no network for labels; {REMEDY}") from error
        if trial.shape != (CLASSES, MULTIPLE, 2 * MULTIPLE):
            raise FormatError(f"weights {path} give {trial.shape[0]} classes, not {CLASSES}; {REMEDY}")

    def __getstate__(self) -> bytes:
        """The file, since a loaded network cannot be sent to another process."""
        return self._file

    def __setstate__(self, file: bytes) -> None:
        """Load the network from its file."""
        self._file, self.sha256 = file, hashlib.sha256(file).hexdigest()
        self._at_work = threading.Lock()
        self._network = cv2.dnn.readNetFromONNX(np.frombuffer(file, np.uint8))

    def probabilities(self, planes: UInt8, step: int) -> Float32:
        """Probabilities (13, h, w) of the classes from channels (24, h, w).

        The network sees images of every ``step``-th pixel; each pixel is in one of them, with its
        own depth, colour and temperature.
        """
        found = np.empty((CLASSES, *planes.shape[1:]), np.float32)
        for top in range(min(step, planes.shape[1])):
            for left in range(min(step, planes.shape[2])):
                found[:, top::step, left::step] = self._scores(planes[:, top::step, left::step])
        return _softmax(found)

    def _scores(self, planes: UInt8) -> Float32:
        """Scores (13, h, w) of one image of channels (24, h, w)."""
        height, width = planes.shape[1:]
        padded = np.pad(planes, ((0, 0), (0, -height % MULTIPLE), (0, -width % MULTIPLE)))
        with self._at_work:
            self._network.setInput(network_input(padded)[None])
            return np.asarray(self._network.forward()[0, :, :height, :width].copy(), np.float32)


@cache
def shipped_reader() -> Reader:
    """The reader that comes with the package."""
    return Reader(SHIPPED_READER)


def _softmax(scores: Float32) -> Float32:
    """Probabilities (k, h, w) from log scores."""
    raised = np.exp(scores - scores.max(axis=0))
    return np.asarray(raised / raised.sum(axis=0), np.float32)
