"""Recorded frames of any kind, recognised by their content; only its reader is imported then."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from sensors.errors import FormatError
from sensors.session.paths import recording_at

if TYPE_CHECKING:
    from sensors.importers.arrays import DepthArrays
    from sensors.importers.azure_mkv import AzureRecording
    from sensors.importers.bags.bag import Bag
    from sensors.importers.bags.orbbec import OrbbecRecording
    from sensors.importers.bags.realsense import RealSenseRecording
    from sensors.importers.flir_images import FlirImages
    from sensors.importers.folder import ImageFolder
    from sensors.importers.pointcloud import CloudFile
    from sensors.session.reader import Session

BagSource: TypeAlias = "Bag | RealSenseRecording | OrbbecRecording"
Source: TypeAlias = (
    "Session | ImageFolder | CloudFile | AzureRecording | BagSource | DepthArrays | FlirImages"
)
"""A ``FrameSource`` with ``len``, and ``notes`` on what is absent or assumed."""

KINDS = (
    "a session, a ROS 1 or 2 bag, an MCAP file with ROS 2 or Foxglove images, a recording of a RealSense "
    "(.db3, .bag), an Orbbec camera (.bag) or an Azure Kinect (.mkv), a folder of depth PNGs, radiometric "
    "JPEGs of a FLIR camera, a cloud (.pcd, .ply, .las, .laz) or arrays (.npy, .npz)"
)
JPEG_MAGIC = b"\xff\xd8\xff"
CLOUDS = (".pcd", ".ply", ".las", ".laz")
BAG_METADATA = "metadata.yaml"
"""In a ROS 2 bag's folder, which is meant where somebody names this file."""


Opener: TypeAlias = "Callable[[], Source]"


def open_source(path: Path) -> "Source":
    """The ``FrameSource`` at ``path``. Raises FormatError for anything else, and what the sources raise."""
    return opener_at(path)()


def opener_at(path: Path) -> "Opener":
    """What opens the ``FrameSource`` at ``path``, whose kind is known before it is read.

    Files are recognised by their first bytes, clouds by their name. Raises FormatError for anything else.
    """
    path = recording_at(path)
    if path.name == BAG_METADATA and path.is_file():
        path = path.parent
    if path.is_dir():
        return _folder(path)
    head = _head(path)
    from sensors.session.mcap_records import MAGIC

    if head.startswith(MAGIC) or path.name.lower().endswith((".mcap", ".mcap.partial")):
        from sensors.importers.bags.bag_files import is_bag
        from sensors.session.reader import Session

        if not (head.startswith(MAGIC) and is_bag(path)):
            return partial(Session, path)
        from sensors.importers.bags.bag import Bag

        return partial(Bag, path)
    if head.startswith((b"SQLite format 3\0", b"#ROSBAG V")):
        return _bag(path)
    return _other(path, head)


def _folder(path: Path) -> "Opener":
    from sensors.importers.bags.bag import Bag
    from sensors.importers.bags.bag_files import is_bag
    from sensors.importers.flir_images import FlirImages, is_flir_alone
    from sensors.importers.folder import ImageFolder

    if is_bag(path):
        return partial(Bag, path)
    return partial(FlirImages if is_flir_alone(path) else ImageFolder, path)


def _bag(path: Path) -> "Opener":
    from sensors.importers.bags.bag import Bag
    from sensors.importers.bags.bag_files import open_rosbag
    from sensors.importers.bags.orbbec import OrbbecRecording, is_orbbec
    from sensors.importers.bags.realsense import RealSenseRecording, is_realsense

    file = open_rosbag(path)
    if is_realsense(file):
        return partial(RealSenseRecording, path)
    return partial(OrbbecRecording if is_orbbec(file) else Bag, path)


def _other(path: Path, head: bytes) -> "Opener":
    """What opens the source of a file that is no recording of messages."""
    from sensors.importers.arrays import NPY_MAGIC, ZIP_MAGIC, DepthArrays
    from sensors.importers.azure_mkv import AzureRecording
    from sensors.importers.flir_images import FlirImages, is_flir_alone
    from sensors.importers.pointcloud import CloudFile

    if head.startswith(b"\x1a\x45\xdf\xa3"):
        return partial(AzureRecording, path)
    if head.startswith((NPY_MAGIC, ZIP_MAGIC)):
        return partial(DepthArrays, path)
    if head.startswith(JPEG_MAGIC) and is_flir_alone(path):
        return partial(FlirImages, path)
    if path.suffix.lower() in CLOUDS:
        return partial(CloudFile, path)
    raise FormatError(f"{path} is of no known kind; give {KINDS}")


def _head(path: Path) -> bytes:
    if not path.exists():
        raise FormatError(f"{path} does not exist; give {KINDS}")
    try:
        with path.open("rb") as file:
            return file.read(16)
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); check its permissions") from error
