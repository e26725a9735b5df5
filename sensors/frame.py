"""One synchronised moment of the rig: depth, colour and temperature as the cameras gave them."""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError

MAX_DEPTH_MM = 65535


@dataclass(frozen=True)
class RigFrame:
    """Depth with whatever colour and temperature belong to it; each in its own camera's pixels.

    depth_mm: uint16 (h, w) millimetres along z, 0 = no reading, lens distortion still in.
    color_encoded: the camera's own JPEG (or PNG) bytes, or None.
    thermal_c: float32 (h, w) degrees Celsius, NaN = no reading, or None.
    stamp_ns: the depth camera's time. Raises FormatError for wrong types or shapes.
    """

    index: int
    stamp_ns: int
    depth_mm: NDArray[np.uint16]
    color_encoded: bytes | None = field(default=None, repr=False)
    thermal_c: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        _check("depth", self.depth_mm, np.uint16)
        if self.thermal_c is not None:
            _check("thermal", self.thermal_c, np.float32)

    def decode_color(self) -> NDArray[np.uint8] | None:
        """Colour image (h, w, 3) RGB, or None where the frame has none.

        Raises FormatError when the bytes are no image.
        """
        if self.color_encoded is None:
            return None
        image = cv2.imdecode(np.frombuffer(self.color_encoded, np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            raise FormatError(
                f"colour image of frame {self.index} cannot be decoded; record it again or drop it"
            )
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


def _check(name: str, image: NDArray[np.generic], dtype: type[np.generic]) -> None:
    if image.ndim != 2 or image.dtype != dtype:
        raise FormatError(
            f"{name} image is {image.dtype} {image.shape}; give {dtype.__name__} with shape (height, width)"
        )
