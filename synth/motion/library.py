"""Motions in files and folders: solved ones, BVH, C3D, TRC, and files of joint positions."""

import hashlib
from pathlib import Path

from sensors.errors import CloudError
from synth.markers.motion_file import Motion, load_motion
from synth.markers.solve import solve, solve_takes
from synth.motion.files import check_motion
from synth.motion_files.archives import is_joint_file
from synth.motion_files.bvh import read_bvh
from synth.motion_files.joint_file import read_joint_file
from synth.motion_files.marker_files import read_markers


def read_motions(path: Path) -> dict[str, Motion]:
    """Motions of one file by name, solved where they are not yet: those of takes by the takes' names.

    Raises CloudError when the file holds none.
    """
    kind = path.suffix.lower()
    if kind == ".npz" and is_joint_file(path):
        return solve_takes(*read_joint_file(path))
    if kind == ".npz":
        return {path.stem: load_motion(path)}
    if kind == ".bvh":
        markers, places = read_bvh(path)
        return {path.stem: solve(markers, markerset=places)}
    return {path.stem: solve(read_markers(path))}


def read_take(path: Path, take: str | None) -> tuple[str, Motion]:
    """Name and motion of a file's take. Raises CloudError where it has several and none of them is named."""
    check_motion(path)
    if path.suffix.lower() == ".npz" and is_joint_file(path):
        takes, places = read_joint_file(path)
        if take is None and len(takes) == 1:
            take = next(iter(takes))
        if take not in takes:
            shown = ", ".join(list(takes)[:6])
            raise CloudError(f"{path} has {len(takes)} takes; name one with --take: {shown}, ...")
        return take, solve(takes[take], markerset=places)
    ((name, motion),) = read_motions(path).items()
    if take not in (None, name):
        raise CloudError(f"{path} has no take {take!r}; leave out --take")
    return name, motion


def digest(files: list[Path]) -> str:
    """SHA-256 of the contents of files, in order."""
    whole = hashlib.sha256()
    for path in files:
        whole.update(hashlib.sha256(path.read_bytes()).digest())
    return whole.hexdigest()
