"""Opens whatever holds recorded frames: a session, a folder of PNGs, or a point cloud."""

from pathlib import Path

from sensors.errors import FormatError
from sensors.folder import ImageFolder
from sensors.pointcloud import CloudFile
from sensors.replay import Session


def open_source(path: Path) -> Session | ImageFolder | CloudFile:
    """The ``FrameSource`` at ``path``, recognised by its name; with ``len``, and ``notes`` on what is absent.

    Sessions end in .mcap (or .mcap.partial while unfinished), clouds in .pcd or .ply; a folder holds PNGs.
    Raises FormatError for anything else, and what the sources themselves raise.
    """
    name = path.name.lower()
    if path.is_dir():
        return ImageFolder(path)
    if not path.exists():
        raise FormatError(f"{path} does not exist; give a session, a folder of depth PNGs, or a point cloud")
    if name.endswith((".mcap", ".mcap.partial")):
        return Session(path)
    if name.endswith((".pcd", ".ply")):
        return CloudFile(path)
    raise FormatError(f"{path} is of no known kind; give .mcap, .pcd, .ply or a folder of depth PNGs")
