"""Opening of recorded frames of any kind; the kind is recognised by content, and only its importer is
loaded.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from sensors.errors import CalibrationError, CloudError, FormatError, Note, Setting
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.session.recording_file import recording_at

if TYPE_CHECKING:
    from sensors.rig.frame import FrameSource

Source: TypeAlias = "FrameSource"

KINDS = (
    "a session, a ROS 1 or 2 bag, an MCAP file with ROS 2 or Foxglove images, a recording of a RealSense "
    "(.db3, .bag), an Orbbec camera (.bag) or an Azure Kinect (.mkv), a folder of depth PNGs, radiometric "
    "JPEGs of a FLIR camera, a cloud (.pcd, .ply, .las, .laz) or arrays (.npy, .npz)"
)
CLOUDS = (".pcd", ".ply", ".las", ".laz")
BAG_METADATA = "metadata.yaml"  # in a ROS 2 bag's folder; its name stands for the folder

_ARRAYS = "save depth (n, h, w) and K as .npz with numpy.savez"
_HDF5 = f"an HDF5 file; read it with h5py and {_ARRAYS}"
_VIDEO = "a video; depth in it is lossy or coloured: give the camera's own recording, or 16-bit PNGs"
_IMAGE = "image; put it into FOLDER/depth, and intrinsics.json into FOLDER"
_ARCHIVE = "an archive; unpack it and give its folder"
_RAW = f"raw bytes without a header; read them with numpy.fromfile and {_ARRAYS}"
_MESH = "a mesh; sample its surface as a cloud (.ply) with Open3D"
_POINTS = "a cloud without a header; save it as .ply or .pcd with Open3D"
_ZED = "a recording of a ZED; export its depth as 16-bit PNGs with the ZED SDK"
_FOREIGN_BYTES = (
    (0, b"\x89HDF\r\n\x1a\n", _HDF5),
    (0, b"MATLAB 5.0 MAT", f"a MATLAB file; read it with scipy.io.loadmat and {_ARRAYS}"),
    (4, b"ftyp", _VIDEO),
    (0, b"RIFF", _VIDEO),
    (0, b"\x89PNG", f"one PNG {_IMAGE}"),
    (0, b"\xff\xd8\xff", "a JPEG without a FLIR camera's temperatures; give a folder with depth images"),
    (0, b"II*\0", f"one TIFF {_IMAGE}"),
    (0, b"MM\0*", f"one TIFF {_IMAGE}"),
    (0, b"<!DOCTYPE html", "a web page; download the file itself"),
    (0, b"<html", "a web page; download the file itself"),
)
"""Kinds that are not read: place of the first bytes, the bytes, and the kind of file with the remedy."""
_FOREIGN_SUFFIXES = {
    ".mat": f"a MATLAB file; read it with scipy.io.loadmat, or h5py for version 7.3, and {_ARRAYS}",
    **dict.fromkeys((".h5", ".hdf5"), _HDF5),
    **dict.fromkeys((".bin", ".raw"), _RAW),
    ".oni": "a recording of OpenNI; export its depth as 16-bit PNGs with OpenNI",
    ".xef": "a recording of Kinect Studio; export its depth as 16-bit PNGs",
    **dict.fromkeys((".svo", ".svo2"), _ZED),
    ".klg": "a log of ElasticFusion; unpack its depth as 16-bit PNGs",
    **dict.fromkeys((".mp4", ".avi", ".mov", ".webm"), _VIDEO),
    ".exr": "one EXR image; save depth as 16-bit PNG or .npy",
    **dict.fromkeys((".zip", ".tar", ".7z"), _ARCHIVE),
    ".gz": "an archive; unpack it and give its content",
    **dict.fromkeys((".obj", ".stl"), _MESH),
    **dict.fromkeys((".xyz", ".pts"), _POINTS),
    ".e57": "a scan; save it as .ply or .las with CloudCompare",
    ".yaml": "a text file; give the recording itself: of a ROS 2 bag the folder that holds metadata.yaml",
    ".json": "a text file; give the recording itself",
    ".txt": "a text file; give the folder that the list belongs to",
}


class Opener(NamedTuple):
    """Function that opens a source.

    own: True if the source itself applies the declared unit and intrinsics. topics: True if the source has
    topics. axes: True if it is a cloud of points. whole: True if its cameras need no check, because this
    program recorded the session.
    """

    read: "Callable[[], FrameSource]"
    own: bool = False
    topics: bool = False
    axes: bool = False
    whole: bool = False


def open_source(path: Path, options: ImportOptions = AS_STATED) -> "FrameSource":
    """Open the ``FrameSource`` at ``path``, as its user declares it.

    Raises FormatError for unknown kinds of files, CalibrationError for impossible cameras, and the errors of
    sources.
    """
    opener = opener_at(path, options)
    if options.topics and not opener.topics:
        raise CloudError(f"{path} has no topics; leave the topic out", Setting.TOPIC)
    if options.axes and not opener.axes:
        raise CloudError(f"{path} is not a cloud of points; leave the axes out", Setting.AXES)
    source = opener.read()
    if options != AS_STATED:
        from sensors.importers.declared import Declared

        source = Declared(source, options, own=opener.own)
    if not opener.whole:
        from sensors.checks.camera_check import check_rig

        check_rig(source.calibration, path.name)
    return source


def doubts_of(source: "FrameSource") -> tuple[str, ...]:
    """Return doubts about depth and cameras of a source that was opened without checks."""
    return tuple(note for note in judged_notes(source) if note not in source.notes and not _is_range(note))


def judged_notes(source: "FrameSource") -> tuple[str, ...]:
    """Return the notes of a source and of the checks of depth and cameras, even if it was opened without
    checks.

    Samples that cannot be read are named. Raises FormatError where the images are not depth.
    """
    from sensors.checks.camera_check import check_rig
    from sensors.checks.depth_check import judge_depth, spread

    if any(map(_is_range, source.notes)):
        return tuple(source.notes)
    notes, samples = list(source.notes), []
    try:
        check_rig(source.calibration, "doubtful calibration")
    except CalibrationError as error:
        notes.append(Note(str(error), *error.settings))
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
    """Return the opener of the ``FrameSource`` at ``path``, without reading the source.

    Files are recognised by their first bytes, clouds by their name. Raises FormatError for unknown kinds.
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

        if head.startswith(MAGIC) and is_bag(path):
            return _bag(path, options)
        return Opener(partial(Session, path), whole=True)
    if head.startswith((b"SQLite format 3\0", b"#ROSBAG V")):
        return _rosbag(path, options)
    return _other(path, head, options)


def _folder(path: Path, options: ImportOptions) -> Opener:
    from sensors.importers.bags.bag_files import is_bag
    from sensors.importers.flir_images import FlirImages, is_flir_alone
    from sensors.importers.folder import ImageFolder

    if is_bag(path):
        return _bag(path, options)
    if is_flir_alone(path):
        return Opener(partial(FlirImages, path))
    return Opener(partial(ImageFolder, path, options), own=True)


def _bag(path: Path, options: ImportOptions) -> Opener:
    from sensors.importers.bags.bag import Bag

    return Opener(partial(Bag, path, options), own=True, topics=True)


def _rosbag(path: Path, options: ImportOptions) -> Opener:
    from sensors.importers.bags.bag_files import open_rosbag
    from sensors.importers.bags.orbbec import OrbbecRecording, is_orbbec
    from sensors.importers.bags.realsense import RealSenseRecording, is_realsense

    file = open_rosbag(path)
    if is_realsense(file):
        return Opener(partial(RealSenseRecording, path, options), own=True)
    if is_orbbec(file):
        return Opener(partial(OrbbecRecording, path, options), own=True)
    return _bag(path, options)


def _other(path: Path, head: bytes, options: ImportOptions) -> Opener:
    """Return the opener of a file that is not a recording of messages."""
    from sensors.files.images import JPEG_MAGIC
    from sensors.importers.arrays import NPY_MAGIC, ZIP_MAGIC, DepthArrays
    from sensors.importers.azure_mkv import AzureRecording
    from sensors.importers.flir_images import FlirImages, is_flir_alone

    suffix = path.suffix.lower()
    if head.startswith(b"\x1a\x45\xdf\xa3"):
        return Opener(partial(AzureRecording, path))
    if head.startswith((NPY_MAGIC, ZIP_MAGIC)) and suffix != ".zip":
        return Opener(partial(DepthArrays, path, options), own=True)
    if head.startswith(JPEG_MAGIC) and is_flir_alone(path):
        return Opener(partial(FlirImages, path))
    if suffix in CLOUDS:
        from sensors.importers.clouds.cloud_source import CloudFile

        return Opener(partial(CloudFile, path, options), own=True, axes=True)
    by_bytes = (text for at, magic, text in _FOREIGN_BYTES if head[at:].startswith(magic))
    if kind := next(by_bytes, None) or _FOREIGN_SUFFIXES.get(suffix):
        raise FormatError(f"{path} is of an unsupported kind: {kind}")
    from sensors.files.own_files import own_file

    if own := own_file(path):
        raise FormatError(f"{path} {own.instead_of('a recording')}")
    raise FormatError(f"{path} is of an unknown kind; see the kinds: annotate-cloud import --help")


def _head(path: Path) -> bytes:
    if not path.exists():
        raise FormatError(f"{path} does not exist; check its name")
    try:
        with path.open("rb") as file:
            return file.read(32)
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); check path and permissions") from error
