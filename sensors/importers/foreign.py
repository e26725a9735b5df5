"""Files that are not read, by their content or name, and what to do with them."""

from pathlib import Path

from sensors.errors import FormatError

_ARRAYS = "save depth (n, h, w) and K as .npz with numpy.savez"
_HDF5 = f"an HDF5 file; read it with h5py and {_ARRAYS}"
_VIDEO = "a video; depth in it is lossy or coloured: give the camera's own recording, or 16-bit PNGs"
_MAGIC = (
    (0, b"\x89HDF\r\n\x1a\n", _HDF5),
    (0, b"MATLAB 5.0 MAT", f"a MATLAB file; read it with scipy.io.loadmat and {_ARRAYS}"),
    (4, b"ftyp", _VIDEO),
    (0, b"RIFF", _VIDEO),
    (0, b"\x89PNG", "one PNG image; put it into FOLDER/depth, and intrinsics.json into FOLDER"),
    (0, b"\xff\xd8\xff", "a JPEG without a FLIR camera's temperatures; give a folder with depth images"),
    (0, b"II*\0", "one TIFF image; put it into FOLDER/depth, and intrinsics.json into FOLDER"),
    (0, b"MM\0*", "one TIFF image; put it into FOLDER/depth, and intrinsics.json into FOLDER"),
    (0, b"<!DOCTYPE html", "a web page; download the file itself"),
    (0, b"<html", "a web page; download the file itself"),
)
"""Place of telling bytes, the bytes, and the kind of file with the remedy."""
_SUFFIXES = {
    ".mat": f"a MATLAB file; read it with scipy.io.loadmat, or h5py for version 7.3, and {_ARRAYS}",
    ".h5": _HDF5,
    ".hdf5": _HDF5,
    ".bin": f"raw bytes without a header; read them with numpy.fromfile and {_ARRAYS}",
    ".raw": f"raw bytes without a header; read them with numpy.fromfile and {_ARRAYS}",
    ".oni": "a recording of OpenNI; export its depth as 16-bit PNGs with OpenNI",
    ".xef": "a recording of Kinect Studio; export its depth as 16-bit PNGs",
    ".svo": "a recording of a ZED; export its depth as 16-bit PNGs with the ZED SDK",
    ".svo2": "a recording of a ZED; export its depth as 16-bit PNGs with the ZED SDK",
    ".klg": "a log of ElasticFusion; unpack its depth as 16-bit PNGs",
    ".mp4": _VIDEO,
    ".avi": _VIDEO,
    ".mov": _VIDEO,
    ".webm": _VIDEO,
    ".exr": "one EXR image; save depth as 16-bit PNG or .npy",
    ".zip": "an archive; unpack it and give its folder",
    ".tar": "an archive; unpack it and give its folder",
    ".gz": "an archive; unpack it and give its content",
    ".7z": "an archive; unpack it and give its folder",
    ".obj": "a mesh; sample its surface as a cloud (.ply) with Open3D",
    ".stl": "a mesh; sample its surface as a cloud (.ply) with Open3D",
    ".xyz": "a cloud without a header; save it as .ply or .pcd with Open3D",
    ".pts": "a cloud without a header; save it as .ply or .pcd with Open3D",
    ".e57": "a scan; save it as .ply or .las with CloudCompare",
    ".yaml": "a text file; give the recording itself: of a ROS 2 bag the folder that holds metadata.yaml",
    ".json": "a text file; give the recording itself, and the camera with --intrinsics",
    ".txt": "a text file; give the folder that the list belongs to",
}
"""Kind of file by suffix, with the remedy."""


def refuse(path: Path, head: bytes) -> FormatError:
    """Return the error for a file of no kind that is read, by its first bytes, else by its name."""
    by_bytes = (text for at, magic, text in _MAGIC if head[at:].startswith(magic))
    what = next(by_bytes, None) or _SUFFIXES.get(path.suffix.lower())
    if what is not None:
        return FormatError(f"{path} is of no known kind: {what}")
    return FormatError(f"{path} is of no known kind; 'annotate-cloud import --help' lists what is read")
