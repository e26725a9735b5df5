"""Results on disk: an .npz file of counts, with texts as JSON."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from sys import intern
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from annotate.frame_labels import Status
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from annotate.scheme.scheme_file import scheme_from_fields, scheme_to_fields
from eval.compare.compare import Comparison
from eval.compare.pairs import Digests
from eval.scores.counts import FrameCounts, width
from eval.scores.joint_visibility import VISIBILITIES
from eval.scores.joints import N_JOINTS
from eval.scores.traits import Traits
from sensors.errors import CloudError, FormatError, fault_of
from sensors.files.atomic import check_free, replacing
from sensors.files.npz import array_sizes, load_arrays

SCHEMA = 8
OF_PAPER = 7
"""Schema of results without a scheme, whose scheme is ``paper``; older schemas are refused."""
REMEDY = "give a result of 'evaluate --out'; evaluate again if another version wrote it"
MAX_BYTES = 2_000_000_000  # of a result in memory: 600,000 frames
NUMBERS = ("distance_m", "invalid_share", "mm_per_px")
WORDS = ("activity", "posture", "facing", "sensor", "view", "status", "predicted_status", "hard")
# Fields of ``Traits``: NUMBERS are stored as arrays, WORDS as JSON.
JOINTS: dict[str, type[np.generic]] = {"joints_mm": np.float64, "joints_seen": np.uint8}
DIGESTS = Digests._fields


@dataclass(frozen=True)
class Result:
    """Comparison with a title. facts: text by name, e.g. command, hashes, paths of the sets."""

    title: str
    comparison: Comparison
    facts: Mapping[str, str] = field(default_factory=dict)


def save_result(path: Path, result: Result, overwrite: bool = False) -> None:
    """Write a result atomically.

    Arrays: counts int32 (F, K), see ``FrameCounts.flat``; joints_mm float64 and joints_seen uint8 (F, 15), if
    known; distance_m, invalid_share, mm_per_px float64 (F,); texts uint8 (bytes,), JSON of the rest. Raises
    ExistsError for an existing file without `overwrite`, CloudError for more than ``MAX_BYTES``.
    """
    check_free(path, overwrite)
    arrays = _arrays(result)
    if (size := sum(array.nbytes for array in arrays.values())) > MAX_BYTES:
        frames = len(result.comparison.frame_ids)
        raise CloudError(
            f"a result of {frames} frames has {size} bytes, over {MAX_BYTES}; evaluate fewer frames at a time"
        )
    with replacing(path, overwrite) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def _arrays(result: Result) -> dict[str, NDArray[Any]]:
    comparison = result.comparison
    texts = {
        "schema": SCHEMA,
        "scheme": scheme_to_fields(comparison.scheme),
        "title": result.title,
        "facts": dict(result.facts),
        "extra_frames": comparison.extra_frames,
        "frame_ids": comparison.frame_ids,
        "subjects": comparison.subjects,
        "digests": {name: [getattr(d, name) for d in comparison.digests] for name in DIGESTS},
        "traits": {name: [getattr(t, name) for t in comparison.traits] for name in WORDS},
    }
    joints = {name: value for name in JOINTS if (value := getattr(comparison, name)) is not None}
    return {
        "counts": comparison.counts.flat.astype(np.int32, copy=False),
        "texts": np.frombuffer(json.dumps(texts, separators=(",", ":")).encode(), np.uint8),
        **{name: np.array([getattr(t, name) for t in comparison.traits]) for name in NUMBERS},
        **joints,
    }


def check_results(*paths: Path) -> None:
    """Check that files contain the arrays of a result. Raises FormatError for the first file without them."""
    for path in paths:
        if missing := {"counts", "texts"} - set(array_sizes(path, REMEDY)):
            raise FormatError(f"{path} is not a result (it lacks {sorted(missing)[0]!r}); {REMEDY}")


def load_result(path: Path) -> Result:
    """Read a result. Raises FormatError if the file holds none."""
    arrays = load_arrays(path, MAX_BYTES, REMEDY)
    try:
        texts = json.loads(arrays["texts"].tobytes())
        scheme = _scheme(texts)
        facts = {_text(name): _text(fact) for name, fact in texts["facts"].items()}
        return Result(_text(texts["title"]), _comparison(arrays, texts, scheme), facts)
    except (CloudError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FormatError(f"{path} is not a result ({fault_of(error)[:200]}); {REMEDY}") from error


def _scheme(texts: dict[str, Any]) -> Scheme:
    if texts["schema"] == OF_PAPER:
        return PAPER
    if texts["schema"] != SCHEMA:
        raise ValueError(f"it is of schema {str(texts['schema'])[:20]}, not {SCHEMA}")
    return scheme_from_fields(texts["scheme"])


def _comparison(arrays: dict[str, NDArray[Any]], texts: dict[str, Any], scheme: Scheme) -> Comparison:
    frames = len(texts["frame_ids"])
    _check(arrays["counts"], np.int32, (frames, width(scheme.n_classes)))
    joints = {name: arrays[name] for name in JOINTS if name in arrays}
    for name, array in joints.items():
        _check(array, JOINTS[name], (frames, N_JOINTS))
    if joints and (len(joints) < len(JOINTS) or joints["joints_seen"].max(initial=0) >= len(VISIBILITIES)):
        raise ValueError("its joints lack a visibility")
    for name in NUMBERS:
        _check(arrays[name], np.float64, (frames,))
    if not set(texts["traits"]["status"] + texts["traits"]["predicted_status"]) <= set(get_args(Status)):
        raise ValueError("it has frames of unknown status")
    if texts["extra_frames"] < 0:
        raise ValueError(f"it has {texts['extra_frames']} frames left over")
    columns: dict[str, Iterable[Any]] = {name: arrays[name].tolist() for name in NUMBERS}
    columns |= {name: map(_text, texts["traits"][name]) for name in WORDS}
    columns["hard"] = (tuple(map(_text, causes)) for causes in texts["traits"]["hard"])
    rows = zip(*columns.values(), strict=True)
    digests = zip(*(map(_text, texts["digests"][name]) for name in DIGESTS), strict=True)
    return Comparison(
        frame_ids=tuple(map(_text, texts["frame_ids"])),
        subjects=tuple(map(_text, texts["subjects"])),
        traits=tuple(Traits(**dict(zip(columns, row, strict=True))) for row in rows),
        digests=tuple(Digests(*row) for row in digests),
        counts=FrameCounts(arrays["counts"], scheme),
        **joints,
        extra_frames=int(texts["extra_frames"]),
    )


def _check(array: NDArray[Any], kind: type[np.generic], shape: tuple[int, ...]) -> None:
    if array.dtype != kind or array.shape != shape or (array < 0).any():
        raise ValueError(f"it holds {array.dtype} {array.shape} instead of {shape} numbers from 0")


def _text(value: object) -> str:
    """Return a value as interned text. Raises ValueError for half a surrogate pair."""
    text = str(value)
    text.encode()
    return intern(text)
