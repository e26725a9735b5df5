"""Which archives (.npz) hold joint angles and which joint positions, told by the names of their arrays."""

from pathlib import Path

from sensors.files.npz import array_sizes

MOTION_REMEDY = "write it with 'solve'"
JOINTS_REMEDY = "give joint_names (J,), parents (J,) and takes of shape (F, J, 3)"
"""What to do about a damaged one."""
JOINT_ARRAYS = {"joint_names", "poses", "joints", "joints3d", "joints_3d", "joint_positions", "smpl_joints"}
"""Arrays of which a file of joints has one: names, rotations of AMASS, or places of SMPL's joints."""


def is_motion(path: Path) -> bool:
    """Whether a file is an archive with joint angles. Raises FormatError where it is a damaged .npz."""
    return path.suffix == ".npz" and path.is_file() and "angles_rad" in array_sizes(path, MOTION_REMEDY)


def is_joint_file(path: Path) -> bool:
    """Return whether a file is an archive of joints. Raises FormatError where it is a damaged .npz."""
    if path.suffix != ".npz" or not path.is_file():
        return False
    return not JOINT_ARRAYS.isdisjoint(array_sizes(path, JOINTS_REMEDY))
