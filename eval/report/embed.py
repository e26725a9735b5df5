"""Values inside the page for its script: JSON that no text can end, arrays as base64."""

import base64
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.parts import PARTS, UNDEFINED
from eval.report.cloud_picture import THERMAL_RANGE_C
from eval.report.figures import ERROR_NAMES, ERROR_RGB
from eval.report.scenes import Scene

SURROUNDINGS_RGB = (84, 86, 94)
"""In a cloud what is no person is grey, where a picture's background is nearly black."""

UNDEFINED_RGB = (150, 140, 120)

_KINDS = {"int16": "i2", "uint8": "u1", "float32": "f4"}


def embedded_json(value: object) -> str:
    """JSON for a script element: `<`, `>` and `&` are escaped, so that no text of it is markup."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def packed(values: NDArray[np.generic]) -> dict[str, str]:
    """An int16, uint8 or float32 array as little-endian base64, as plotly writes them: dtype, bdata."""
    data = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()
    return {"dtype": _KINDS[values.dtype.name], "bdata": base64.b64encode(data).decode()}


def scene_json(scenes: Sequence[Scene]) -> dict[str, Any]:
    """Scenes, and names and colours of the ids in them."""
    parts = {"names": ["Surroundings"] * 256, "colors": [_css(SURROUNDINGS_RGB)] * 256}
    for part in PARTS[1:]:
        parts["names"][part.id], parts["colors"][part.id] = part.title, _css(part.rgb)
    parts["names"][UNDEFINED], parts["colors"][UNDEFINED] = "Undefined", _css(UNDEFINED_RGB)
    errors = {"names": list(ERROR_NAMES), "colors": [_css(rgb) for rgb in ERROR_RGB]}
    errors["colors"][0] = _css(SURROUNDINGS_RGB)
    return {
        "scenes": [
            {
                "points_mm": packed(scene.points_mm),
                "colors": {name: packed(_tight(values)) for name, values in scene.colors.items()},
            }
            for scene in scenes
        ],
        "palettes": {"truth": parts, "predicted": parts, "error": errors},
        "temperature": THERMAL_RANGE_C,
    }


def _tight(values: NDArray[np.generic]) -> NDArray[np.generic]:
    return values if values.dtype == np.uint8 else values.astype(np.float32)


def _css(rgb: tuple[int, int, int]) -> str:
    return "rgb({},{},{})".format(*rgb)
