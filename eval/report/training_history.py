"""Losses, scores and labels of one frame during a training."""

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
from annotate.labelset.scheme_note import scheme_in
from annotate.scheme.scheme import Scheme
from eval.report.frame_images import Image, colorize_depth, colorize_parts
from sensors.errors import FormatError, fault_of
from sensors.files.bounded import read_bounded

HISTORY, FRAME = "history.json", "frame"  # in the folder of `train`
MAX_BYTES = 64_000_000  # of a history.json: a million points
PICTURES = 8  # epochs shown, after the paper's Fig. 7
_EPOCH = re.compile(r"epoch-(\d{1,9})\.parts\.png")


@dataclass(frozen=True)
class Training:
    """Course of a training. points: (n, 2), images seen, mean loss. epochs: (n, 5), number, loss, mean
    recall, mIoU, seconds so far.

    Scores are NaN if not measured. pictures: a frame's depth, labels at some epochs and truth, RGB (h, w, 3).
    scheme: of these labels.
    """

    title: str
    points: Float64
    epochs: Float64
    pictures: Mapping[str, Image]
    scheme: Scheme
    facts: Mapping[str, str]


def load_training(folder: Path) -> Training:
    """Read a folder of `train`. Raises FormatError where its history is missing or corrupt."""
    path = folder / HISTORY
    data = read_bounded(path, MAX_BYTES, "give a folder that 'train' wrote")
    try:
        value = json.loads(data)
        points = _rows(value["points"], ("images", "loss"))
        epochs = _rows(value["epochs"], ("number", "loss", "mean_recall", "miou", "seconds"))
        if len(points) < 2:
            points = np.stack([epochs[:, 0] * float(value["images"]), epochs[:, 1]], axis=-1)
        scheme = scheme_in(value, path)
        return Training(folder.name, points, epochs, _pictures(folder / FRAME, scheme), scheme, _facts(value))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise FormatError(
            f"{path} is not a history of a training ({fault_of(error)}); give a folder that 'train' wrote"
        ) from error


def _rows(entries: list[dict[str, Any]], names: tuple[str, ...]) -> Float64:
    rows = [[math.nan if entry[name] is None else float(entry[name]) for name in names] for entry in entries]
    return np.array(rows, np.float64).reshape(-1, len(names))


def _pictures(folder: Path, scheme: Scheme) -> dict[str, Image]:
    """Return images by title: depth, labels at up to `PICTURES` epochs, truth."""
    found = {int(m[1]): p for p in folder.glob("epoch-*.parts.png") if (m := _EPOCH.fullmatch(p.name))}
    if not found:
        return {}
    numbers = sorted(found)
    # Early epochs differ most: spread by logarithm.
    spread = np.geomspace(1, len(numbers), min(PICTURES, len(numbers))).round().astype(int) - 1
    chosen = [numbers[i] for i in sorted(set(spread.tolist()))]
    pictures = {f"Epoch {n}": colorize_parts(decode_parts(read_bounded(found[n])), scheme) for n in chosen}
    depth, truth = folder / "depth.png", folder / "truth.parts.png"
    if depth.is_file():
        image = colorize_depth(decode_depth(read_bounded(depth)))
        pictures = {"Depth": image, **pictures}
    if truth.is_file():
        pictures["Truth"] = colorize_parts(decode_parts(read_bounded(truth)), scheme)
    return pictures


def _facts(value: dict[str, Any]) -> dict[str, str]:
    names = ("images", "parameters", "device", "torch")
    facts: dict[str, str] = {name: str(value[name]) for name in names if name in value}
    plan = value.get("plan", {})
    return {**facts, **{str(key): _line(entry) for key, entry in plan.items()}}


def _line(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_line(entry)}" for key, entry in value.items())
    return str(value)
