"""Other 2-D pose networks as ONNX files, with SimCC outputs (RTMPose) or heat maps, for COCO's 17 landmarks.

Sources: Li et al., SimCC, arXiv:2107.03332; mmpose, ``codecs/utils/post_processing.py``
(``get_simcc_maximum``) and ``codecs/msra_heatmap.py``. Input: RGB less ImageNet's mean.
"""

import hashlib
from pathlib import Path

import numpy as np

from annotate.array_types import Float32, Float64, UInt8
from annotate.onnx_session import onnx_session
from annotate.witness.person_crop import PersonCrop
from annotate.witness.pose_network import LEAST, PosedPerson
from sensors.errors import FormatError, one_line
from sensors.files.bounded import read_bounded

NAMES = (
    "nose",
    *(f"{side}_{part}" for part in ("eye", "ear", "shoulder") for side in ("left", "right")),
    *(f"{side}_{part}" for part in ("elbow", "wrist", "hip", "knee", "ankle") for side in ("left", "right")),
)
"""COCO's landmarks; Halpe and COCO-WholeBody begin with them."""
MEAN_RGB = np.array([123.675, 116.28, 103.53], np.float32) / np.float32(255)
SD_RGB = np.array([58.395, 57.12, 57.375], np.float32) / np.float32(255)
SURE_VALUE = 0.6  # median value of the landmarks of a certain person: twice mmpose's threshold of 0.3
MAX_BYTES = 1_000_000_000  # of a network's file, read whole
REMEDY = "give a pose network for (1, 3, h, w) with SimCC outputs or heat maps"


class OnnxPose:
    """Network ``PoseNetwork`` of an ONNX file, without a detector and without a mask.

    Input (1, 3, h, w). Outputs: two (1, k, bins) over columns and rows, or one (1, k, h', w'); k is 17 or
    more. Raises FormatError for another network.
    """

    names = NAMES

    def __init__(self, path: Path) -> None:
        data = read_bounded(path, MAX_BYTES, REMEDY)
        try:
            self._session = onnx_session(data)
            given = self._session.get_inputs()[0]
            self._input, (_, _, self._height, self._width) = given.name, given.shape
            self._decoded(np.zeros((self._height, self._width, 3), np.float32))
        except Exception as error:  # ONNX Runtime's own errors share no public base
            text = one_line(str(error))[:150] or "no reason is given"
            raise FormatError(f"{path} is not a pose network ({text}); {REMEDY}") from error
        self.sha256 = hashlib.sha256(data).hexdigest()

    def detect(self, image: UInt8) -> list[PersonCrop]:
        """Return no crop, because the network has no detector."""
        return []

    def landmark(self, image: UInt8, crop: PersonCrop, least: float = LEAST) -> PosedPerson | None:
        """Return the person in a crop; None for a median value below ``least`` of ``SURE_VALUE``."""
        at, value = self._decoded(crop.cut(image, self._width, self._height))
        if np.median(value) < least * SURE_VALUE:
            return None
        placed = crop.points(at, self._width, self._height)
        return PosedPerson(np.column_stack([placed, np.clip(value, 0, 1)]), crop)

    def _decoded(self, image: Float32) -> tuple[Float64, Float64]:
        """Return pixels (17, 2) of the landmarks in a crop (h, w, 3), and values (17,)."""
        planes = ((image - MEAN_RGB) / SD_RGB).transpose(2, 0, 1)[None]
        outputs = [out[0, : len(NAMES)] for out in self._session.run(None, {self._input: planes})]
        size = np.array([self._width, self._height])
        if len(outputs) >= 2 and outputs[0].ndim == outputs[1].ndim == 2:
            at, value = decode_simcc(outputs[0], outputs[1])
            at *= size / (outputs[0].shape[1], outputs[1].shape[1])
        elif outputs[0].ndim == 3:
            at, value = decode_heat(outputs[0])
            at *= size / outputs[0].shape[:0:-1]
        else:
            raise FormatError(f"its first output has shape {outputs[0].shape}")
        if len(at) != len(NAMES):
            raise FormatError(f"it has {len(at)} landmarks, not {len(NAMES)} or more")
        return at, value


def decode_simcc(columns: Float32, rows: Float32) -> tuple[Float64, Float64]:
    """Return bins (k, 2) of the highest values over columns (k, bins) and rows (k, bins), and the lesser of
    both values (k,). Bins are positions, their centres at halves.
    """
    at = np.column_stack([columns.argmax(axis=1), rows.argmax(axis=1)]) + 0.5
    return at, np.minimum(columns.max(axis=1), rows.max(axis=1)).astype(np.float64)


def decode_heat(heat: Float32) -> tuple[Float64, Float64]:
    """Return the places (k, 2) of the highest heat of maps (k, h, w), in cells, and the heat there (k,).

    A place is moved by a quarter cell towards the warmer neighbour. Cell centres are at halves.
    """
    k, _, width = heat.shape
    v, u = np.divmod(heat.reshape(k, -1).argmax(axis=1), width)
    edged = np.pad(heat, ((0, 0), (1, 1), (1, 1)), mode="reflect")
    each = np.arange(k)
    right = edged[each, v + 1, u + 2] - edged[each, v + 1, u]
    down = edged[each, v + 2, u + 1] - edged[each, v, u + 1]
    at = np.column_stack([u + 0.5 + 0.25 * np.sign(right), v + 0.5 + 0.25 * np.sign(down)])
    return at.astype(np.float64), heat[each, v, u].astype(np.float64)
