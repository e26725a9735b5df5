"""Colour maps for temperatures and distances."""

import cv2
import numpy as np

from annotate.array_types import Float32

COLD_C, HOT_C = 18.0, 38.0  # of the temperature colours; untuned
HEAT = cv2.COLORMAP_INFERNO


def heat_rgb(celsius: Float32, missing_rgb: Float32) -> Float32:
    """Return colours (n, 3), 0 to 255, of temperatures (n,); NaN becomes ``missing_rgb``."""
    return mapped_rgb((celsius - COLD_C) / (HOT_C - COLD_C), HEAT, missing_rgb)


def mapped_rgb(share: Float32, colormap: int, missing_rgb: Float32) -> Float32:
    """Return colours (n, 3) of values (n,) in [0, 1] on an OpenCV map; NaN becomes ``missing_rgb``."""
    table = cv2.applyColorMap(np.arange(256, dtype=np.uint8).reshape(-1, 1), colormap)[:, 0, ::-1]
    index = np.clip(np.nan_to_num(share) * 255, 0, 255).astype(np.uint8)
    return np.where(np.isnan(share)[:, None], missing_rgb, table[index].astype(np.float32))
