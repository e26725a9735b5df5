"""An exported network (ONNX), and the parts of a person by it."""

import hashlib
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, UInt8, UInt16
from annotate.crop import SIZE, Crop, nearest_seen, network_crop, normalize
from annotate.labelset.images import Probabilities
from annotate.onnx_session import onnx_session
from annotate.parts import BACKGROUND, N_CLASSES, TWIN_PARTS
from annotate.posture import POSTURES
from annotate.segmentation.segmented_person import Segmentation
from eval.network.body_state import Bearing
from eval.scores.joints import N_JOINTS, TWIN
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

SHIPPED_WEIGHTS = Path(str(files("eval").joinpath("weights", "compact.onnx")))
MAX_WEIGHT_BYTES = 1_000_000_000
"""Of a network's file, which is read whole: the paper's at its published widths has 540 MB."""
ROUNDING = 0.05
"""How far a pixel's probabilities may sum from 1: each of twelve rounded to eight bits leaves 0.024 at most,
to half precision 0.003."""
AT_ONCE = min(4, os.cpu_count() or 1)
"""Crops through a network at once, one thread each: threads that share a crop wait for each other much of the
time."""
WHOLE = ("facing", "posture", "joints")
"""Names of what else a network may give."""
TURNED_BACK: tuple[Callable[[Float32], Float32], ...] = (
    lambda planes: planes[:, TWIN_PARTS, :, ::-1],
    lambda facing: facing * np.array([1, -1], np.float32),
    lambda posture: posture,
    lambda joints: np.array([1, 0, 0], np.float32) + joints[:, TWIN] * np.array([-1, 1, 1], np.float32),
)
"""How an answer for mirror images becomes one for the people: probabilities, facing, posture and joints."""

Image = tuple[UInt16, Bool]
"""Depth in millimetres (h, w) and the person's pixels (h, w)."""


class OnnxNetwork:
    """An exported network, run by ONNX Runtime on the CPU. Loading executes no code from the file.

    Any exporter's, of any precision (float16, or quantised to eight bits). sha256: hash of the file. Raises
    FormatError when the file is no network of this kind: (B, 1, 212, 212) -> probabilities (B, 12, 212, 212),
    all within the file. It may give ``facing``, ``posture`` and ``joints`` too, see `Answer`.
    mirrored: labels are the mean of its answers for a person and for their mirror image (docs/adr/0024),
    which takes twice as long.
    """

    def __init__(self, path: Path = SHIPPED_WEIGHTS, *, mirrored: bool = True) -> None:
        data = read_bounded(path, MAX_WEIGHT_BYTES, "give an exported network (.onnx)")
        if not data:
            raise FormatError(f"weights {path} are empty; give an exported network (.onnx)")
        try:
            self._session = onnx_session(data)
            depth = self._session.get_inputs()[0]
            named = {output.name for output in self._session.get_outputs()}
            self._whole = list(WHOLE) if named >= set(WHOLE) else []
            self._input, self._float = depth.name, np.float16 if "float16" in depth.type else np.float32
            # What a file declares of its inputs and outputs need not be true.
            trial, *whole = self._each(np.full((2, SIZE, SIZE), 0.5, np.float32))
        except Exception as error:  # ONNX Runtime's own errors share no public base
            why = "it keeps tensors in other files" if "xternal" in str(error) else type(error).__name__
            raise FormatError(
                f"weights {path} are not a network for (B, 1, {SIZE}, {SIZE}) ({why}); export again"
            ) from error
        if trial.shape != (2, N_CLASSES, SIZE, SIZE):
            raise FormatError(
                f"weights {path} give {trial.shape} for two crops; give a network of {N_CLASSES} classes at "
                f"{SIZE}x{SIZE}"
            )
        if not ((trial >= 0).all() and np.abs(trial.sum(axis=1) - 1).max() < ROUNDING):
            raise FormatError(f"weights {path} give no probabilities; export the network with its softmax")
        shapes = [(2, 2), (2, len(POSTURES)), (2, N_JOINTS, 3)]
        if whole and [values.shape for values in whole] != shapes:
            raise FormatError(f"weights {path} give facing, posture and joints of other shapes than {shapes}")
        self.sha256, self._mirrored = hashlib.sha256(data).hexdigest(), mirrored

    def probabilities(self, crops: Float32) -> Float32:
        """Normalised crops (B, 212, 212) -> class probabilities (B, 12, 212, 212)."""
        return self.answers(crops)[0]

    def answers(self, crops: Float32) -> list[Float32]:
        """Class probabilities, and facing, posture, joints where the network gives them."""
        if not self._mirrored:
            return self._each(crops)
        pairs = (np.split(answer, 2) for answer in self._each(np.concatenate([crops, crops[..., ::-1]])))
        half = np.float32(0.5)
        return [half * (own + back(other)) for (own, other), back in zip(pairs, TURNED_BACK, strict=False)]

    def _each(self, crops: Float32) -> list[Float32]:
        """The network's own answers for crops."""
        first = self._session.get_outputs()[0].name

        # One crop at a time: products of matrices round otherwise with other crops beside it.
        def run(crop: Float32) -> list[Float32]:
            crop = crop[None, None].astype(self._float)
            return self._session.run([first, *self._whole], {self._input: crop})  # type: ignore[no-any-return]

        if len(crops) == 1:
            return [answer.astype(np.float32, copy=False) for answer in run(crops[0])]
        with ThreadPoolExecutor(AT_ONCE, "network") as threads:
            each = list(threads.map(run, crops))
        return [np.concatenate(answers, dtype=np.float32) for answers in zip(*each, strict=True)]

    def segment(self, depth_mm: UInt16, person: Bool, *, probabilities: bool = False) -> Segmentation:
        """Label the person of a depth image; both (h, w), see ``segment_all``."""
        return self.segment_all([(depth_mm, person)], probabilities=probabilities)[0]

    def segment_all(self, images: Sequence[Image], *, probabilities: bool = False) -> list[Segmentation]:
        """Label the persons of depth images of any sizes: every pixel of them with depth gets a body part.

        An image of 212 x 212 is a crop already, as in training. probabilities: keep those of all classes.
        The answer for an image does not depend on those beside it, to the bit.
        """
        masks = [person & (depth_mm > 0) for depth_mm, person in images]
        there = [i for i, mask in enumerate(masks) if mask.any()]
        results = [_nobody(mask.shape) for mask in masks]
        for i, look in zip(there, self._looks([(images[i][0], masks[i]) for i in there]), strict=True):
            results[i] = look.labels(masks[i], probabilities)
        return results

    def _looks(self, images: Sequence[Image]) -> list["_Look"]:
        """Answers for images whose masks have pixels."""
        if not images:
            return []
        crops, depths = zip(*(_input(*image) for image in images), strict=True)
        planes, *wholes = self.answers(np.stack(depths))
        return [
            _Look(image, crop, depth > 0, planes[k], [values[k] for values in wholes])
            for k, (image, crop, depth) in enumerate(zip(images, crops, depths, strict=True))
        ]


@dataclass(frozen=True, eq=False)
class _Look:
    """A network's answer for a person. seen: where the crop shows them; planes: (12, 212, 212).

    whole: facing, posture and joints, where the network gives them.
    """

    image: Image
    crop: Crop
    seen: Bool
    planes: Float32
    whole: Sequence[Float32]

    def labels(self, mask: Bool, probabilities: bool) -> Segmentation:
        """Labels of the pixels of a mask (h, w), all of the person's or some."""
        # The extraction has decided what is person: background is no answer there.
        best, certain = _likeliest(self.planes.reshape(N_CLASSES, -1))
        # A smaller crop drops pixels: on a rim the one that stands for one of the person may show the room.
        nearest = nearest_seen(self.seen)
        best = self.crop.paste(best[nearest], mask.shape, BACKGROUND)
        certain = self.crop.paste(certain[nearest], mask.shape, 0.0)
        best[~mask], certain[~mask] = BACKGROUND, 0.0
        bearing = Bearing.of(self.crop, *self.image, *self.whole).note() if self.whole else None
        given = Probabilities(self.crop, self.planes) if probabilities else None
        return Segmentation(best, certain, probabilities=given, bearing=bearing)


@njit(cache=True, nogil=True)
def _likeliest(planes: Float32) -> tuple[UInt8, Float32]:
    """The likeliest part (n,) that is not background, the first of equals, and its probability.

    planes: (12, n), by part.
    """
    best, certain = np.ones(planes.shape[1], np.uint8), planes[1].copy()
    for k in range(2, planes.shape[0]):
        for i in range(planes.shape[1]):
            above = planes[k, i] > certain[i]
            best[i] = np.uint8(k) if above else best[i]
            certain[i] = planes[k, i] if above else certain[i]
    return best, certain


def _input(depth_mm: UInt16, mask: Bool) -> tuple[Crop, Float32]:
    """The square around a person's pixels (h, w), and the network's input of it."""
    crop = network_crop(mask)
    return crop, normalize(crop.cut(depth_mm, 0), crop.cut(mask, False))


def _nobody(shape: tuple[int, ...]) -> Segmentation:
    nothing = np.full(shape, BACKGROUND, np.uint8)
    return Segmentation(nothing, np.zeros(shape, np.float32), ("no person: nothing to label",))
