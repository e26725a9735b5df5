"""Recorded frames of any kind, recognised by their content; only its reader is imported then."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from sensors.errors import CalibrationError, CloudError, FormatError
from sensors.importers.foreign import refuse
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.session.paths import recording_at

if TYPE_CHECKING:
    from sensors.rig.frame import FrameSource

Source: TypeAlias = "FrameSource"

KINDS = (
    "a session, a ROS 1 or 2 bag, an MCAP file with ROS 2 or Foxglove images, a recording of a RealSense "
    "(.db3, .bag), an Orbbec camera (.bag) or an Azure Kinect (.mkv), a folder of depth PNGs, radiometric "
    "JPEGs of a FLIR camera, a cloud (.pcd, .ply, .las, .laz) or arrays (.npy, .npz)"
)
CLOUDS = (".pcd", ".ply", ".las", ".laz")
BAG_METADATA = "metadata.yaml"
"""File in a ROS 2 bag's folder; its name stands for the folder."""


class Opener(NamedTuple):
    """Function that opens a source.

    own: whether the source obeys unit and intrinsics itself. topics: whether the source has topics.
    whole: whether its cameras are taken as they are, because the session was made here.
    """

    read: "Callable[[], FrameSource]"
    own: bool = False
    topics: bool = False
    whole: bool = False


def open_source(path: Path, options: ImportOptions = AS_STATED) -> "FrameSource":
    """Open the ``FrameSource`` at ``path``, as its user declares it.

    Raises FormatError for anything else, CalibrationError for cameras that none is, and what sources raise.
    """
    opener = opener_at(path, options)
    if options.topics and not opener.topics:
        raise CloudError(f"{path} has no topics; leave --topic out")
    source = opener.read()
    if options != AS_STATED:
        from sensors.importers.declared import Declared

        source = Declared(source, options, own=opener.own)
    if not opener.whole:
        from sensors.checks.camera_check import check_rig

        check_rig(source.calibration, path.name)
    return source


def doubts_of(source: "FrameSource") -> tuple[str, ...]:
    """Return the judges' doubts about depth and cameras of a source that was not judged at its opening."""
    return tuple(note for note in judged_notes(source) if note not in source.notes and not _is_range(note))


def judged_notes(source: "FrameSource") -> tuple[str, ...]:
    """Return the notes of a source; with the judges' on depth and cameras if the source is not judged yet.

    A frame that is looked at and cannot be read is named. Raises FormatError where the images are no depth.
    """
    from sensors.checks.camera_check import check_rig
    from sensors.checks.depth_check import judge_depth, spread

    if any(map(_is_range, source.notes)):
        return tuple(source.notes)
    notes = list(source.notes)
    try:
        check_rig(source.calibration, "doubtful calibration")
    except CalibrationError as error:
        notes.append(str(error))
    samples = []
    for at in spread(len(source)):
        try:
            samples.append(source.frame(at).depth_mm)
        except CloudError as error:
            # One damaged frame costs that frame: the others are judged, and labelled.
            notes.append(f"doubtful: frame {at:06d} cannot be read: {error}")
    return (*notes, *judge_depth(samples, 1.0, source.name).notes)


def _is_range(note: str) -> bool:
    from sensors.checks.depth_check import JUDGED

    return note.startswith(JUDGED)


def opener_at(path: Path, options: ImportOptions = AS_STATED) -> Opener:
    """What opens the ``FrameSource`` at ``path``, whose kind is known before it is read.

    Files are recognised by their first bytes, clouds by their name. Raises FormatError for anything else.
    """
    path = recording_at(path)
    if path.name == BAG_METADATA and path.is_file():
        path = path.parent
    if path.is_dir():
        return _folder(path, options)
    head = _head(path)
    from sensors.session.mcap_records import MAGIC

    if head.startswith(MAGIC) or path.name.lower().endswith((".mcap", ".mcap.partial")):
        from sensors.importers.bags.bag_files import is_bag
        from sensors.session.reader import Session

        if not (head.startswith(MAGIC) and is_bag(path)):
            return Opener(partial(Session, path), whole=True)
        from sensors.importers.bags.bag import Bag

        return Opener(partial(Bag, path, options), own=True, topics=True)
    if head.startswith((b"SQLite format 3\0", b"#ROSBAG V")):
        return _bag(path, options)
    return _other(path, head, options)


def _folder(path: Path, options: ImportOptions) -> Opener:
    from sensors.importers.bags.bag import Bag
    from sensors.importers.bags.bag_files import is_bag
    from sensors.importers.flir_images import FlirImages, is_flir_alone
    from sensors.importers.folder import ImageFolder

    if is_bag(path):
        return Opener(partial(Bag, path, options), own=True, topics=True)
    if is_flir_alone(path):
        return Opener(partial(FlirImages, path))
    return Opener(partial(ImageFolder, path, options), own=True)


def _bag(path: Path, options: ImportOptions) -> Opener:
    from sensors.importers.bags.bag import Bag
    from sensors.importers.bags.bag_files import open_rosbag
    from sensors.importers.bags.orbbec import OrbbecRecording, is_orbbec
    from sensors.importers.bags.realsense import RealSenseRecording, is_realsense

    file = open_rosbag(path)
    if is_realsense(file):
        return Opener(partial(RealSenseRecording, path, options), own=True)
    if is_orbbec(file):
        return Opener(partial(OrbbecRecording, path, options), own=True)
    return Opener(partial(Bag, path, options), own=True, topics=True)


def _other(path: Path, head: bytes, options: ImportOptions) -> Opener:
    """What opens the source of a file that is no recording of messages."""
    from sensors.files.images import JPEG_MAGIC
    from sensors.importers.arrays import NPY_MAGIC, ZIP_MAGIC, DepthArrays
    from sensors.importers.azure_mkv import AzureRecording
    from sensors.importers.flir_images import FlirImages, is_flir_alone

    if head.startswith(b"\x1a\x45\xdf\xa3"):
        return Opener(partial(AzureRecording, path))
    if head.startswith((NPY_MAGIC, ZIP_MAGIC)) and path.suffix.lower() != ".zip":
        return Opener(partial(DepthArrays, path, options), own=True)
    if head.startswith(JPEG_MAGIC) and is_flir_alone(path):
        return Opener(partial(FlirImages, path))
    if path.suffix.lower() in CLOUDS:
        from sensors.importers.clouds.cloud_source import CloudFile

        return Opener(partial(CloudFile, path, options), own=True)
    raise refuse(path, head)


def _head(path: Path) -> bytes:
    if not path.exists():
        raise FormatError(f"{path} does not exist; check its name")
    try:
        with path.open("rb") as file:
            return file.read(32)
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); check its permissions") from error
