"""Which archives (.npz) hold joint angles and which joint positions, told by the names of their arrays."""

from pathlib import Path

from sensors.files.npz import array_sizes

MOTION_REMEDY = "write it with 'solve'"
JOINTS_REMEDY = "give joint_names (J,), parents (J,) and takes of shape (F, J, 3)"
"""What to do about a damaged one."""


def is_motion(path: Path) -> bool:
    """Whether a file is an archive with joint angles. Raises FormatError where it is a damaged .npz."""
    return path.suffix == ".npz" and path.is_file() and "angles_rad" in array_sizes(path, MOTION_REMEDY)


def is_joint_file(path: Path) -> bool:
    """Whether a file is an archive of joint positions. Raises FormatError where it is a damaged .npz."""
    return path.suffix == ".npz" and path.is_file() and "joint_names" in array_sizes(path, JOINTS_REMEDY)
