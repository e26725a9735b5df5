"""Motions in files and folders, solved or not, and a repertoire of poses for datasets.

Solvers are imported where they run, because recognising a file needs no compiled code.
"""

import hashlib
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from annotate.array_types import Int64
from sensors.errors import CloudError, Setting
from sensors.files.npz import array_sizes

if TYPE_CHECKING:
    from synth.markers.motion_file import Motion
    from synth.motion.grounded import Grounded

SUFFIXES = (".npz", ".bvh", ".c3d", ".trc")
POSES_PER_SECOND = 10.0  # frames of a motion nearer to each other differ too little; untuned
MOST_POSES = 20_000  # 0.3 kB each go to every worker with every task; untuned


def is_motion(path: Path) -> bool:
    """Return whether a file is an archive of joint angles. Raises FormatError for a damaged .npz."""
    if path.suffix != ".npz" or not path.is_file():
        return False
    return "angles_rad" in array_sizes(path, "write it with 'solve'")


def _is_joint_file(path: Path) -> bool:
    from synth.motion_files.joint_file import JOINT_ARRAYS, REMEDY

    return path.suffix == ".npz" and path.is_file() and bool(JOINT_ARRAYS & {*array_sizes(path, REMEDY)})


def check_motion(path: Path) -> None:
    """Raise CloudError for a folder, and for a file that is not a motion."""
    if path.is_dir():
        raise CloudError(f"{path} is a folder; give one motion of it")
    motion_files(path)


def motion_files(path: Path) -> list[Path]:
    """Return the motion file, or the motion files in a folder and its folders, sorted by name.

    Raises CloudError when there are none.
    """

    def known(file: Path) -> bool:
        return file.suffix.lower() != ".npz" or is_motion(file) or _is_joint_file(file)

    if not path.is_dir():
        if not path.exists():
            raise CloudError(f"{path} does not exist; give a motion, or a folder of them")
        if path.suffix.lower() not in SUFFIXES or not known(path):
            raise CloudError(_not_a_motion(path))
        return [path]
    inside = sorted(p for p in path.rglob("*") if p.suffix.lower() in SUFFIXES and p.is_file())
    if not (found := list(filter(known, inside))):
        raise CloudError(f"{path} holds no motions; give a folder with .npz, .bvh, .c3d or .trc files")
    return found


def _not_a_motion(path: Path) -> str:
    if path.suffix.lower() != ".npz":
        return f"{path} is not a motion; give .npz, .bvh, .c3d or .trc"
    from synth.motion_files.joint_file import REMEDY

    held = ", ".join([*array_sizes(path, REMEDY)][:6]) or "nothing"
    return f"{path} holds {held}, not a motion; {REMEDY}"


def read_motions(path: Path) -> dict[str, "Motion"]:
    """Return the motions of a file by name: of each take, or the only one; joint angles are solved from
    markers.

    Raises CloudError for another kind of file.
    """
    from synth.markers.motion_file import load_motion
    from synth.markers.solve import solve, solve_takes
    from synth.motion_files.bvh import read_bvh
    from synth.motion_files.joint_file import read_joint_file
    from synth.motion_files.marker_files import read_markers

    kind = path.suffix.lower()
    if kind == ".npz" and _is_joint_file(path):
        return solve_takes(*read_joint_file(path))
    if kind == ".npz":
        return {path.stem: load_motion(path)}
    if kind == ".bvh":
        markers, places = read_bvh(path)
        return {path.stem: solve(markers, markerset=places)}
    return {path.stem: solve(read_markers(path))}


def read_take(path: Path, take: str | None) -> tuple[str, "Motion"]:
    """Return name and motion of a take in a file.

    take: None if the file has only one. Raises CloudError for several takes without a name, and for an
    unknown name.
    """
    check_motion(path)
    if path.suffix.lower() == ".npz" and _is_joint_file(path):
        from synth.markers.solve import solve
        from synth.motion_files.joint_file import read_joint_file

        takes, places = read_joint_file(path)
        if take is None and len(takes) == 1:
            take = next(iter(takes))
        if take not in takes:
            shown = ", ".join(list(takes)[:6]) + (", ..." if len(takes) > 6 else "")
            held = f"{len(takes)} takes" if take is None else f"no take {take!r}"
            raise CloudError(f"{path} has {held}; name one: {shown}", Setting.TAKE)
        return take, solve(takes[take], markerset=places)
    ((name, motion),) = read_motions(path).items()
    if take not in (None, name):
        raise CloudError(f"{path} has no take {take!r}; leave it out", Setting.TAKE)
    return name, motion


def digest(files: list[Path]) -> str:
    """Return the SHA-256 of the contents of files, in order."""
    whole = hashlib.sha256()
    for path in files:
        whole.update(hashlib.sha256(path.read_bytes()).digest())
    return whole.hexdigest()


@dataclass(frozen=True, eq=False)
class Repertoire:
    """Motions to draw poses from. sha256: of the files. assumed: sentences on assumptions in solving, each
    with its number of files.
    """

    name: str
    sha256: str
    motions: "dict[str, Grounded]"
    assumed: tuple[str, ...] = ()

    def draw(self, rng: np.random.Generator) -> "tuple[str, Grounded, int]":
        """Draw a motion's name, the motion, and one of its frames; all motions have the same probability."""
        name = str(rng.choice(list(self.motions)))
        motion = self.motions[name]
        return name, motion, int(rng.integers(len(motion)))

    def manifest(self) -> dict[str, Any]:
        return {"name": self.name, "sha256": self.sha256, "motions": len(self.motions)}


def read_repertoire(path: Path, advance: Callable[[int], None] = lambda _: None) -> Repertoire:
    """Read a motion file, or a folder of them.

    advance: called with 1 for each file. Raises CloudError without motions, or for an unreadable one.
    """
    from synth.motion.grounded import ground

    files = motion_files(path)
    motions: dict[str, Grounded] = {}
    assumed: Counter[str] = Counter()
    frames = left_out = 0
    for file in files:
        read = read_motions(file)
        if not is_motion(file):
            assumed.update({line for motion in read.values() for line in motion.report.assumed})
        for name, motion in read.items():
            grounded = ground(motion)
            frames, left_out = frames + len(grounded), left_out + int((~grounded.sound).sum())
            if grounded.sound.any():
                motions[_label(path, file, name, motions)] = _thinned(grounded)
        advance(1)
    if not motions:
        raise CloudError(f"{path}: no frame of its motions can be a person's; record again")
    lines = [f"{line} ({count} of {len(files)} files)" for line, count in assumed.items()]
    if left_out:
        lines.append(f"{left_out} of {frames} frames are left out as impossible movements; check fps")
    return Repertoire(path.name, digest(files), _bounded(motions), tuple(lines))


def _label(path: Path, file: Path, name: str, taken: Collection[str]) -> str:
    """Return a name of a motion in a file at or below path that is not taken yet."""
    inside = f"{file.relative_to(path)}/{name}" if path.is_dir() else name
    plain = [name] if name == file.stem or not path.is_dir() else []
    return next(label for label in (*plain, f"{file.stem}/{name}", inside) if label not in taken)


def _thinned(grounded: "Grounded") -> "Grounded":
    sound = np.flatnonzero(grounded.sound)
    every = max(1, round(grounded.frames_per_second / POSES_PER_SECOND))
    return _frames(grounded, sound[:: min(every, len(sound))])


def _bounded(motions: "dict[str, Grounded]") -> "dict[str, Grounded]":
    every = -(-sum(map(len, motions.values())) // MOST_POSES)
    return {name: _frames(motion, np.arange(0, len(motion), every)) for name, motion in motions.items()}


def _frames(grounded: "Grounded", chosen: Int64) -> "Grounded":
    arrays = ("angles_rad", "path_m", "clear_m", "sits", "sound")
    return replace(grounded, **{name: getattr(grounded, name)[chosen] for name in arrays})
