"""True joints of any recording, in a file of JSON lines as ``predict --joints`` writes it."""

import json
from pathlib import Path

import numpy as np

from eval.benchmark.benchmark_set import TRUE_NAMES, BenchmarkSet
from eval.scores.intervals import UNKNOWN
from eval.scores.joint_errors import FARTHEST_MM
from sensors.errors import FormatError, fault_of
from sensors.files.bounded import read_bounded
from sensors.rig.frame import FrameSource

JOINTS_FILE = "joints.jsonl"
MAX_BYTES = 256_000_000  # of a file, read whole; 100,000 frames have 80 MB


def read_joint_truth(source: FrameSource, path: Path) -> BenchmarkSet:
    """Read the true joints of a recording's frames.

    A line has ``frame``, the number of the frame from 0, and ``joints_mm``: name to x, y, z, millimetres in
    coordinates of the undistorted depth camera. It may have ``subject``, and ``hidden``: names of hidden
    joints. Lines of a ``person`` other than 1 are left out. Raises FormatError for malformed lines.
    """
    names, remedy = TRUE_NAMES, "give lines as predict --joints writes them"
    true_m = np.full((len(source), len(names), 3), np.nan)
    visible = np.ones(true_m.shape[:2], np.bool_)
    subjects = [source.subject or UNKNOWN] * len(source)
    for number, line in enumerate(read_bounded(path, MAX_BYTES, remedy).splitlines(), 1):
        try:
            row = json.loads(line)
            if row.get("person", 1) != 1:
                continue
            index = int(row["frame"])
            if not 0 <= index < len(source):
                raise ValueError(f"{source.name} has no frame {index}, but 0 to {len(source) - 1}")
            if not np.isnan(true_m[index]).all():
                raise ValueError(f"frame {index} is repeated")
            if unknown := [name for name in (*row["joints_mm"], *row.get("hidden", ())) if name not in names]:
                raise ValueError(f"joint {str(unknown[0])[:40]!r} is unknown")
            for name, place in row["joints_mm"].items():
                true_m[index, names.index(name)] = np.array(place, np.float64) / 1000
            if (np.abs(true_m[index]) > FARTHEST_MM / 1000).any():
                raise ValueError("a joint is farther than 100 m from the camera")
            visible[index, [names.index(name) for name in row.get("hidden", ())]] = False
            subjects[index] = str(row.get("subject") or subjects[index])
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError) as error:
            raise FormatError(f"{path}, line {number} is malformed ({fault_of(error)}); {remedy}") from error
    known = np.flatnonzero(~np.isnan(true_m).all(axis=(0, 2)))
    kept = tuple(names[i] for i in known)
    return BenchmarkSet(source, kept, true_m[:, known], visible[:, known], tuple(subjects))
