"""Agreement of label sets of the same frames: each pair compared, with the second as the reference."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import combinations
from typing import Any, Self

import numpy as np

from annotate.array_types import Float64, UInt8
from annotate.frame_labels import FrameLabels
from annotate.labelset.labelled_frames import LabelledFrames, camera_of, pinhole_of
from annotate.scheme.merging import finest_common
from annotate.scheme.scheme import Scheme
from eval.compare.compare import Comparison, compare_sets
from eval.compare.results import Result
from eval.network.body_state import BodyState
from eval.scores.intervals import UNKNOWN
from eval.scores.joint_errors import TRUE_JOINTS, true_joints_mm
from eval.scores.joint_visibility import OUTSIDE, inside, visibility
from eval.scores.joints import N_JOINTS
from sensors.errors import CloudError

TURNED_DEG = 30.0  # largest angle between two facings that agree


@dataclass(frozen=True, eq=False)
class Agreement:
    """Label set ``a`` compared with ``b`` as the reference.

    result: its joints are the distances between the joints of both sets. turned_deg: float64 (F,), angle
    between both facings, NaN where a set has none. postures: of both sets in each frame, "" = none.
    """

    a: str
    b: str
    result: Result
    turned_deg: Float64
    postures: Sequence[tuple[str, str]]

    @property
    def comparison(self) -> Comparison:
        """Return the comparison of the parts."""
        return self.result.comparison

    def to_json(self) -> dict[str, Any]:
        """Return the scores as JSON."""
        names = ("frames", "same")
        return {
            "a": self.a,
            "b": self.b,
            **self.comparison.to_json(),
            "facing": dict(zip(names, self.same_facing[::-1], strict=True)),
            "posture": dict(zip(names, self.same_posture[::-1], strict=True)),
        }

    @property
    def has_people(self) -> bool:
        """Return whether the frames show two named people or more, over whom an interval can be drawn."""
        named = set(self.comparison.subjects)
        return len(named) > 1 and UNKNOWN not in named

    @property
    def same_facing(self) -> tuple[int, int]:
        """Return the number of frames whose facings agree, and of frames with both facings."""
        known = self.turned_deg[~np.isnan(self.turned_deg)]
        return int((known <= TURNED_DEG).sum()), len(known)

    @property
    def same_posture(self) -> tuple[int, int]:
        """Return the number of frames whose postures agree, and of frames with both postures."""
        both = [(one, other) for one, other in self.postures if one and other]
        return sum(one == other for one, other in both), len(both)


def agreements(
    sets: Mapping[str, LabelledFrames], advance: Callable[[int], None] = lambda frames: None
) -> list[Agreement]:
    """Compare each pair of label sets, by name, in the finest scheme that all convert to.

    advance: called with a number of frames, in total ``work_of``. Raises CloudError for fewer than two sets,
    and the errors of ``compare_sets``.
    """
    if len(sets) < 2:
        raise CloudError(f"{len(sets)} label set is given; give two or more label sets of the same frames")
    schemes = [frames.scheme for frames in sets.values()]
    scheme = reduce(lambda one, other: finest_common(one, other).scheme, schemes)
    bodies = {name: _bodies(frames, advance) for name, frames in sets.items()}
    pairs = combinations(sets, 2)
    return [_agreement(pair, sets, scheme, bodies, advance) for pair in pairs]


def work_of(sets: Mapping[str, LabelledFrames]) -> int:
    """Return the number of frames that ``agreements`` reads, for its progress."""
    return sum(map(len, sets.values())) + sum(len(sets[b]) for _, b in combinations(sets, 2))


@dataclass(frozen=True, eq=False)
class _Body:
    """Subject of a frame: joints (15, 3), millimetres, and their visibility; NaN and ``OUTSIDE`` without."""

    joints_mm: Float64
    seen: UInt8
    facing_deg: float = np.nan
    posture: str = ""

    @classmethod
    def of(cls, frames: LabelledFrames, frame: FrameLabels) -> Self:
        camera = camera_of(frames, frame)
        pinhole = pinhole_of(frame, camera)
        state = BodyState.from_note(frame.notes.get("bearing"))
        if TRUE_JOINTS in frame.notes:
            joints_mm = true_joints_mm(frame)
        else:
            joints_mm = state.joints_mm(pinhole) if state else np.full((N_JOINTS, 3), np.nan)
        with np.errstate(invalid="ignore"):
            seen = visibility(joints_mm, frame.depth_mm, pinhole)
            own = np.where(inside(joints_mm, camera), seen, np.uint8(OUTSIDE))
        return cls(joints_mm, own, state.facing_deg, state.name) if state else cls(joints_mm, own)


def _bodies(frames: LabelledFrames, advance: Callable[[int], None]) -> dict[str, _Body]:
    """Return the subject of each frame by frame id."""
    bodies = {}
    for entry in frames.entries():
        bodies[entry.frame_id] = _Body.of(frames, frames.load(entry, persons=False))
        advance(1)
    return bodies


def _agreement(
    names: tuple[str, str],
    sets: Mapping[str, LabelledFrames],
    scheme: Scheme,
    bodies: Mapping[str, Mapping[str, _Body]],
    advance: Callable[[int], None],
) -> Agreement:
    a, b = names
    comparison = compare_sets(sets[a], sets[b], advance, scheme=scheme)
    pairs = [(bodies[a][frame_id], bodies[b][frame_id]) for frame_id in comparison.frame_ids]
    apart_mm = np.array([np.linalg.norm(one.joints_mm - other.joints_mm, axis=1) for one, other in pairs])
    if np.isfinite(apart_mm).any():
        seen = np.array([other.seen for _, other in pairs])
        comparison = replace(comparison, joints_mm=apart_mm, joints_seen=seen)
    turned = np.array([one.facing_deg - other.facing_deg for one, other in pairs])
    facts = {"predicted": str(sets[a].path), "truth": str(sets[b].path)}
    return Agreement(
        a,
        b,
        Result(f"{a} against {b}", comparison, facts),
        np.abs((turned + 180) % 360 - 180),
        [(one.posture, other.posture) for one, other in pairs],
    )
