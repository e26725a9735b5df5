"""Marker sets: which place on the body a marker's name stands for."""

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from annotate.array_types import Float64, Int64
from sensors.errors import CloudError, FormatError
from sensors.files.bounded import read_toml
from synth.body.skeleton import JOINT_ID
from synth.shipped import shipped

MIN_MARKERS = 8
"""Known names without which a set does not fit a recording. Chosen by eye."""
MAX_FILE_BYTES = 1_000_000
"""A shipped set has 5 kB at most."""
DEFAULT_SPREAD_MM = 30.0
"""Standard deviation of a marker's place where the file has none. Chosen by eye."""


@dataclass(frozen=True)
class MarkerSet:
    """Places of markers on a body 1.70 m tall in anatomical zero.

    names: of the M markers. joint: int64 (M,) the joint each moves with. at_m: (M, 3) metres from it,
    x to the person's left, y back, z up. spread_m: (M,) standard deviation of that place. weight: (M,).
    """

    name: str
    names: tuple[str, ...]
    joint: Int64
    at_m: Float64
    spread_m: Float64
    weight: Float64


def key_of(label: str) -> str:
    """What two spellings of a label share: no prefix up to the last colon, no punctuation, one case."""
    return re.sub(r"[^0-9a-z]", "", label.rpartition(":")[2].casefold())


def load_marker_set(path: Path) -> MarkerSet:
    """Read a marker-set file (TOML). Raises FormatError naming the entry that is wrong."""
    content = read_toml(path, MAX_FILE_BYTES, "give a marker-set file (TOML)")
    markers = content.get("markers")
    if not isinstance(markers, dict) or not markers:
        raise FormatError(f"marker set {path} has no table [markers] with entries; add it")
    if len({key_of(name) for name in markers}) < len(markers):
        raise FormatError(
            f"marker set {path} names a marker twice; labels must differ in more than case and punctuation"
        )
    rows = [_place(path, name, entry) for name, entry in markers.items()]
    joint, at, spread, weight = zip(*rows, strict=True)
    return MarkerSet(
        str(content.get("name", path.stem)),
        tuple(markers),
        np.array(joint, np.int64),
        np.array(at, float),
        np.array(spread, float) / 1000,
        np.array(weight, float),
    )


def _place(path: Path, name: str, entry: object) -> tuple[int, list[float], float, float]:
    try:
        assert isinstance(entry, dict)
        joint, at = JOINT_ID[entry["joint"]], [float(v) for v in entry["at_m"]]
        spread, weight = float(entry.get("spread_mm", DEFAULT_SPREAD_MM)), float(entry.get("weight", 1.0))
        assert len(at) == 3 and all(abs(v) <= 1 for v in at) and 0 < spread <= 1000 and 0 < weight <= 100
    except (AssertionError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise FormatError(
            f"marker set {path}: {name} is not a place; give "
            '{ joint = "left_knee", at_m = [0.05, 0, 0], spread_mm = 30, weight = 1 }'
        ) from error
    return joint, at, spread, weight


@cache
def shipped_marker_sets() -> tuple[MarkerSet, ...]:
    """The sets that come with the package: Plug-in-Gait, CMU-41, a Vicon set of 53 and OpenSim's of 51."""
    return tuple(load_marker_set(path) for path in sorted(shipped("markersets").glob("*.toml")))


def choose_marker_set(labels: tuple[str, ...]) -> MarkerSet:
    """The shipped set with most of the labels. Raises CloudError when none has enough."""
    present = {key_of(label) for label in labels}

    def known(markers: MarkerSet) -> int:
        return sum(key_of(name) in present for name in markers.names)

    best = max(shipped_marker_sets(), key=lambda s: (known(s), -len(s.names)))
    if known(best) < MIN_MARKERS:
        shown = ", ".join(labels[:6])
        raise CloudError(f"unknown markers ({shown}, ...); give a marker-set file that describes them")
    return best
