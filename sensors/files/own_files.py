"""Files and folders that this program writes, named for a verb that takes another kind."""

import tomllib
import zipfile
from pathlib import Path
from typing import NamedTuple

MAX_TEXT_BYTES = 1 << 20  # of a TOML file that is looked at; untuned


class OwnFile(NamedTuple):
    """Kind of a file or folder of this program, and the verbs that take it."""

    kind: str
    use: str

    def instead_of(self, wanted: str) -> str:
        """Return the end of an error: the kind, the kind that is wanted, and the use."""
        return f"is {self.kind}, not {wanted}; {self.use}"


RECORDING = "a recording"
IN_FOLDER = {
    "labelset.json": OwnFile("a label set", "'predict', 'fix', 'evaluate' and 'convert' take it"),
    "dataset.json": OwnFile("a dataset", "'train' takes it, 'predict' writes a label set of it"),
    "try.json": OwnFile("the folder of 'try'", "give a file or a label set in it"),
    "weights.onnx": OwnFile("the folder of a network", "'predict --weights' takes weights.onnx in it"),
    "rig.toml": OwnFile("the folder of a rig", "give rig.toml in it to 'record --rig'"),
    "report.html": OwnFile("the folder of a report", "open report.html in it in a browser"),
}
"""Kinds of folders by a file in it; the first that is there counts."""
BY_SUFFIX = {
    ".onnx": OwnFile("a network", "give it to 'predict --weights'"),
    ".safetensors": OwnFile("the weights of a network", "give them to 'train --init'"),
    ".html": OwnFile("a page", "open it in a browser"),
    ".mcap": OwnFile(RECORDING, "'label', 'predict' and 'info' take it"),
}
BY_KEY = {
    "colors": OwnFile("the palette of a suit", "give it to 'label --suit' or 'simulate --suit'"),
    "parts": OwnFile("a scheme", "give it to 'scheme check' or 'predict --scheme'"),
    "devices": OwnFile("a rig file", "give it to 'record --rig' or 'live --rig'"),
}
"""Kinds of TOML files by a key."""
RESULTS = OwnFile("the results of 'evaluate'", "give them to 'compare' or 'report'")
RESULT_ARRAYS = {"counts.npy", "texts.npy"}


def own_file(path: Path) -> OwnFile | None:
    """Return the kind of this program's file or folder at a path; None for others."""
    if path.is_dir():
        return next((own for name, own in IN_FOLDER.items() if (path / name).is_file()), None)
    if not path.is_file():
        return None
    suffix = path.suffix.lower()
    if suffix == ".toml":
        keys = _keys(path)
        return next((own for key, own in BY_KEY.items() if key in keys), None)
    if suffix == ".npz":
        return RESULTS if _members(path) >= RESULT_ARRAYS else None
    return BY_SUFFIX.get(suffix)


def _keys(path: Path) -> set[str]:
    """Return the keys of a TOML file; none of one that cannot be read."""
    try:
        if path.stat().st_size > MAX_TEXT_BYTES:
            return set()
        return set(tomllib.loads(path.read_text("utf-8")))
    except (OSError, ValueError, RecursionError):
        return set()


def _members(path: Path) -> set[str]:
    """Return the names of the arrays in an NPZ file; none of one that cannot be read."""
    try:
        with zipfile.ZipFile(path) as file:
            return set(file.namelist())
    except (OSError, ValueError, zipfile.BadZipFile):
        return set()
