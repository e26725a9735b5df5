"""History of a training for the report: losses, scores, and the labels of one frame by epoch."""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from annotate.array_types import Float64
from annotate.labelset.images import decode_depth, decode_parts
from eval.report import frame_images as figures
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

HISTORY, FRAME = "history.json", "frame"
"""File and folder that `train` writes (``eval.training.train``)."""
MAX_BYTES = 64_000_000
"""Of a history.json: a million points."""
PICTURES = 8
"""The paper's Fig. 7 shows the labelling at seven epochs."""

_EPOCH = re.compile(r"epoch-(\d{1,9})\.parts\.png")


@dataclass(frozen=True)
class Training:
    """History of one training.

    points: images seen, mean loss. epochs: number, loss, mean recall, mIoU, seconds so far; scores are NaN
    where not measured. pictures: RGB (h, w, 3) of one frame by title: depth, labels at some epochs, truth.
    facts: the plan as text.
    """

    title: str
    points: Float64
    epochs: Float64
    pictures: Mapping[str, figures.Image]
    facts: Mapping[str, str]


def load_training(folder: Path) -> Training:
    """Read the folder that `train` wrote. Raises FormatError for any other or a corrupt folder."""
    path = folder / HISTORY
    data = read_bounded(path, MAX_BYTES, "give a folder that 'train' wrote")
    try:
        value = json.loads(data)
        points = _rows(value["points"], ("images", "loss"))
        epochs = _rows(value["epochs"], ("number", "loss", "mean_recall", "miou", "seconds"))
        if len(points) < 2:
            # A short training has no more than its epochs.
            points = np.stack([epochs[:, 0] * float(value["images"]), epochs[:, 1]], axis=-1)
        return Training(folder.name, points, epochs, _pictures(folder / FRAME), _facts(value))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise FormatError(
            f"{path} is not a history of a training ({error}); give a folder that 'train' wrote"
        ) from error


def _rows(entries: list[dict[str, Any]], names: tuple[str, ...]) -> Float64:
    rows = [[math.nan if entry[name] is None else float(entry[name]) for name in names] for entry in entries]
    return np.array(rows, np.float64).reshape(-1, len(names))


def _pictures(folder: Path) -> dict[str, figures.Image]:
    """Return pictures of depth, of labels at up to `PICTURES` epochs spread over the training, and of the
    truth.
    """
    found = {int(m[1]): p for p in folder.glob("epoch-*.parts.png") if (m := _EPOCH.fullmatch(p.name))}
    if not found:
        return {}
    numbers = sorted(found)
    # Early epochs differ most: spread by logarithm, as the paper's choice of 0 to 1,000 nearly is.
    spread = np.geomspace(1, len(numbers), min(PICTURES, len(numbers))).round().astype(int) - 1
    chosen = [numbers[i] for i in sorted(set(spread.tolist()))]
    pictures = {f"Epoch {n}": figures.colorize_parts(decode_parts(read_bounded(found[n]))) for n in chosen}
    depth, truth = folder / "depth.png", folder / "truth.parts.png"
    if depth.is_file():
        image = figures.colorize_depth(decode_depth(read_bounded(depth)))
        pictures = {"Depth": image, **pictures}
    if truth.is_file():
        pictures["Truth"] = figures.colorize_parts(decode_parts(read_bounded(truth)))
    return pictures


def _facts(value: dict[str, Any]) -> dict[str, str]:
    """Return the network, recipe and data of a training as lines of text."""
    names = ("images", "parameters", "device", "torch")
    facts: dict[str, str] = {name: str(value[name]) for name in names if name in value}
    plan = value.get("plan", {})
    return {**facts, **{str(key): _line(entry) for key, entry in plan.items()}}


def _line(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_line(entry)}" for key, entry in value.items())
    return str(value)
