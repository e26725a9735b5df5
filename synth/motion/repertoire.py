"""Repertoire: poses of recorded motions, thinned to different ones, from which datasets are generated."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from annotate.array_types import Int64
from sensors.errors import CloudError
from synth.motion.grounded import Grounded, ground
from synth.motion.library import digest, is_motion, motion_files, read_motions

POSES_PER_SECOND = 10.0  # frames of a motion nearer to each other differ too little; untuned
MOST_POSES = 20_000  # 0.3 kB each go to every worker with every task; untuned


@dataclass(frozen=True, eq=False)
class Repertoire:
    """Motions to draw poses from.

    sha256: of the files. assumed: lines on the files solved on the way, each with its number of files.
    """

    name: str
    sha256: str
    motions: dict[str, Grounded]
    assumed: tuple[str, ...] = ()

    def draw(self, rng: np.random.Generator) -> tuple[str, Grounded, int]:
        """Draw a motion's name, the motion, and one of its frames; every motion is as likely."""
        name = str(rng.choice(list(self.motions)))
        motion = self.motions[name]
        return name, motion, int(rng.integers(len(motion)))

    def manifest(self) -> dict[str, Any]:
        return {"name": self.name, "sha256": self.sha256, "motions": len(self.motions)}


def read_repertoire(path: Path, advance: Callable[[int], None] = lambda _: None) -> Repertoire:
    """Read a motion file, or a folder of them; ``advance`` gets 1 a file.

    Raises CloudError without motions, or for an unreadable one.
    """
    files = motion_files(path)
    motions: dict[str, Grounded] = {}
    assumed: Counter[str] = Counter()
    for file in files:
        read = read_motions(file)
        if not is_motion(file):
            assumed.update({line for motion in read.values() for line in motion.report.assumed})
        for name, motion in read.items():
            grounded = ground(motion)
            if grounded.sound.any():
                motions[name if name not in motions else f"{file.stem}/{name}"] = _thinned(grounded)
        advance(1)
    if not motions:
        raise CloudError(f"{path}: no frame of its motions can be a person's; record again")
    lines = tuple(f"{line} ({count} of {len(files)} files)" for line, count in assumed.items())
    return Repertoire(path.name, digest(files), _bounded(motions), lines)


def _thinned(grounded: Grounded) -> Grounded:
    sound = np.flatnonzero(grounded.sound)
    every = max(1, round(grounded.frames_per_second / POSES_PER_SECOND))
    return _frames(grounded, sound[:: min(every, len(sound))])


def _bounded(motions: dict[str, Grounded]) -> dict[str, Grounded]:
    every = -(-sum(map(len, motions.values())) // MOST_POSES)
    return {name: _frames(motion, np.arange(0, len(motion), every)) for name, motion in motions.items()}


def _frames(grounded: Grounded, chosen: Int64) -> Grounded:
    arrays = ("angles_rad", "path_m", "clear_m", "sits", "sound")
    return replace(grounded, **{name: getattr(grounded, name)[chosen] for name in arrays})
