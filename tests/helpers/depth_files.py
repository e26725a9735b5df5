"""Small depth images and their intrinsics as files, and what a file that is refused must do."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from sensors.errors import CloudError
from sensors.importers.open_source import open_source
from sensors.rig.camera import Intrinsics

NUMBERS = {"fx": 30, "fy": 31.0, "cx": 15.5, "cy": 11.5, "width": 32, "height": 24}
CAMERA = Intrinsics(32, 24, 30.0, 31.0, 15.5, 11.5)


def depth_image(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 5000, (24, 32), np.uint16)


def png(image: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", image)[1])


def write(path: Path, content: bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def assert_refused(path: Path, match: str = "", kind: type[CloudError] = CloudError) -> None:
    """Opening it, or reading its frames, raises one line."""
    with pytest.raises(kind, match=match or None) as error:
        list(open_source(path))
    assert "\n" not in str(error.value)
