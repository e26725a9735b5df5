"""Files that may hold a motion: which they are, without reading them."""

from pathlib import Path

from sensors.errors import CloudError
from synth.motion_files.archives import is_joint_file, is_motion

SUFFIXES = (".npz", ".bvh", ".c3d", ".trc")
"""Of files that may hold a motion."""


def check_motion(path: Path) -> None:
    """Check that a file may hold a motion. Raises CloudError for a folder, or what holds none."""
    if path.is_dir():
        raise CloudError(f"{path} is a folder; give one motion of it")
    motion_files(path)


def motion_files(path: Path) -> list[Path]:
    """The file, or the files of a folder (and of folders within) that hold motions, sorted by name.

    Raises CloudError when there are none.
    """
    if not path.is_dir():
        if not path.exists():
            raise CloudError(f"{path} does not exist; give a motion, or a folder of them")
        if path.suffix.lower() not in SUFFIXES or (path.suffix == ".npz" and not _known(path)):
            raise CloudError(f"{path} is not a motion; give .npz, .bvh, .c3d or .trc")
        return [path]
    inside = sorted(p for p in path.rglob("*") if p.suffix.lower() in SUFFIXES and p.is_file())
    found = [p for p in inside if p.suffix.lower() != ".npz" or _known(p)]
    if not found:
        raise CloudError(f"{path} holds no motions; give a folder with .npz, .bvh, .c3d or .trc files")
    return found


def _known(path: Path) -> bool:
    return is_motion(path) or is_joint_file(path)
