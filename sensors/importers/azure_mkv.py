"""A recording of Microsoft's ``k4arecorder`` (Azure Kinect, Matroska) as a source of frames.

Depth and infrared are raw big-endian 16-bit images, colour is the camera's own JPEG, so no codec is needed.
Format: Azure Kinect DK documentation, "Azure Kinect DK recording file format".
"""

from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.errors import CalibrationError, FormatError
from sensors.importers.azure_calibration import calibration_from_factory
from sensors.importers.ebml import EbmlFile, Element
from sensors.rig.frame import FrameSource, RigFrame
from sensors.rig.pairing import COLOR_WINDOW_NS, pair_stamps

EBML, SEGMENT, INFO, SCALE = 0x1A45DFA3, 0x18538067, 0x1549A966, 0x2AD7B1
TRACKS, TRACK, NUMBER, NAME, PRIVATE = 0x1654AE6B, 0xAE, 0xD7, 0x536E, 0x63A2
ATTACHMENTS, ATTACHED, FILE_NAME, FILE_DATA = 0x1941A469, 0x61A7, 0x466E, 0x465C
TAGS, TAG, SIMPLE_TAG, TAG_NAME, TAG_STRING = 0x1254C367, 0x7373, 0x67C8, 0x45A3, 0x4487
CLUSTER, TIMESTAMP, SIMPLE_BLOCK, BLOCK_GROUP, BLOCK = 0x1F43B675, 0xE7, 0xA3, 0xA0, 0xA1
"""Ids of the Matroska specification, RFC 9559."""

DEFAULT_SCALE_NS = 1_000_000
DEPTH, COLOR, INFRARED = "DEPTH", "COLOR", "IR"
OTHERS = {COLOR: ("colour", COLOR_WINDOW_NS), INFRARED: ("infrared", 0)}
"""In words, and the longest time (ns) between an image and its depth image."""
WANTED = {DEPTH: b"b16g", COLOR: b"MJPG", INFRARED: b"b16g"}  # tracks, and the pixel format that is read


class Track(NamedTuple):
    """Video track.

    fourcc: pixel format of its BITMAPINFOHEADER. images: times, ns on the recording's clock, and file
    positions, in the order of time, without an image that the file's end cuts off.
    """

    name: str
    width: int
    height: int
    fourcc: bytes
    images: list[tuple[int, Element]]

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Return the times (n,) of the images."""
        return np.array([stamp_ns for stamp_ns, _ in self.images], np.int64)


class AzureRecording(FrameSource):
    """An Azure Kinect recording as a ``FrameSource``; depth is master, images are read one at a time.

    notes: missing data, origin of the calibration. Raises FormatError for a file that is not such a recording
    or has no depth, CalibrationError when the calibration is missing or unknown.
    """

    path: Path

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.stem
        try:
            with path.open("rb") as file:
                self._scan(EbmlFile(file))
        except OSError as error:
            raise FormatError(
                f"{path} cannot be read ({error.strerror}); check path and permissions"
            ) from error

    def _frame(self, index: int) -> RigFrame:
        stamp_ns, payload = self._tracks[DEPTH].images[index]
        with self.path.open("rb") as file:
            ebml = EbmlFile(file)
            color, infrared = self._paired_image(COLOR, index), self._paired_image(INFRARED, index)
            return RigFrame(
                index=index,
                stamp_ns=stamp_ns,
                depth_mm=self._grey(ebml, DEPTH, payload),
                color_encoded=ebml.bytes(color) if color else None,
                infrared=self._grey(ebml, INFRARED, infrared) if infrared else None,
            )

    def _scan(self, ebml: EbmlFile) -> None:
        nothing = Element(0, 0, 0)
        if next(ebml.children(ebml.whole), nothing).id != EBML:
            raise FormatError(f"{self.path} is not a Matroska file; give a recording of k4arecorder")
        segment = next(ebml.find(ebml.whole, SEGMENT), nothing)
        tracks = _tracks(ebml, segment)
        self._tracks = {t.name: t for t in tracks if WANTED.get(t.name) == t.fourcc}
        if DEPTH not in {track.name for track in tracks}:
            raise FormatError(f"{self.path} has no DEPTH track; give an Azure Kinect recording with depth")
        if DEPTH not in self._tracks or not self._tracks[DEPTH].images:
            why = " (it is cut off)" if ebml.cut else ""
            raise FormatError(f"{self.path} holds no readable depth image{why}; record with a depth mode")
        depth, color = self._tracks[DEPTH], self._tracks.get(COLOR)
        named = ebml.find(segment, TAGS, TAG, SIMPLE_TAG)
        tags = {name: ebml.text(value) for name, value in _named(ebml, named, TAG_NAME, TAG_STRING)}
        files = _named(ebml, ebml.find(segment, ATTACHMENTS, ATTACHED), FILE_NAME, FILE_DATA)
        self.times_ns = depth.stamps_ns
        name = tags.get("K4A_CALIBRATION_FILE", "calibration.json")
        factory = next((ebml.bytes(content) for file, content in files if file == name), None)
        if factory is None:
            raise CalibrationError(f"{self.path} has no attachment {name[:60]!r}; record it with k4arecorder")
        mode, size = tags.get("K4A_DEPTH_MODE", ""), (depth.width, depth.height)
        color_size = (color.width, color.height) if color else None
        self.calibration = calibration_from_factory(factory, size, color_size, mode)
        none = Track("", 0, 0, b"", [])
        self._pairs = {
            other: pair_stamps(self.times_ns, self._tracks.get(other, none).stamps_ns, window_ns)
            for other, (_, window_ns) in OTHERS.items()
        }
        self.notes = (
            f"intrinsics and poses from the camera's own calibration.json, for {mode} at {size[0]}x{size[1]}",
            *(
                f"no {OTHERS[name][0]} images"
                for name, pairs in self._pairs.items()
                if not (pairs >= 0).any()
            ),
            *(
                f"{track.name} images are {track.fourcc.decode('ascii', 'replace')!r}: left out"
                for track in tracks
                if track.name in WANTED and track.fourcc != WANTED[track.name]
            ),
            *([f"{self.path.name} is cut off: its end is lost"] if ebml.cut else []),
            "no thermal images",
        )

    def _paired_image(self, name: str, index: int) -> Element | None:
        pair = int(self._pairs[name][index])
        return self._tracks[name].images[pair][1] if pair >= 0 else None

    def _grey(self, ebml: EbmlFile, name: str, payload: Element) -> NDArray[np.uint16]:
        width, height = self._tracks[name].width, self._tracks[name].height
        if payload.size != 2 * width * height:
            raise FormatError(
                f"{self.path}: a {name} image has {payload.size} bytes, not {width}x{height} of 16 bits; "
                "record it again"
            )
        return np.frombuffer(ebml.bytes(payload), ">u2").astype(np.uint16).reshape(height, width)


def _tracks(ebml: EbmlFile, segment: Element) -> list[Track]:
    """Return the tracks with their images; images cut off at the end are left out."""
    tracks = {}
    for entry in ebml.find(segment, TRACKS, TRACK):
        parts = {child.id: child for child in ebml.children(entry)}
        if {NUMBER, NAME, PRIVATE} <= set(parts):
            # BITMAPINFOHEADER: size, width, height, planes, bits, compression, ...
            header = ebml.bytes(parts[PRIVATE])
            width, height = (int.from_bytes(header[at : at + 4], "little") for at in (4, 8))
            track = Track(ebml.text(parts[NAME]), width, height, header[16:20], [])
            tracks[ebml.number(parts[NUMBER])] = track
    scale = next(map(ebml.number, ebml.find(segment, INFO, SCALE)), DEFAULT_SCALE_NS)
    for cluster in ebml.find(segment, CLUSTER):
        start = 0
        for child in ebml.children(cluster):
            if child.id == TIMESTAMP:
                start = ebml.number(child)
            grouped = ebml.find(child, BLOCK) if child.id == BLOCK_GROUP else ()
            for block in (child,) if child.id == SIMPLE_BLOCK else grouped:
                number, ticks, payload = _block(ebml, block)
                stamp_ns = (start + ticks) * scale
                if number in tracks and 0 <= stamp_ns < 1 << 62 and not payload.cut:
                    tracks[number].images.append((stamp_ns, payload))
    for track in tracks.values():
        track.images.sort(key=itemgetter(0))
    return list(tracks.values())


def _block(ebml: EbmlFile, block: Element) -> tuple[int, int, Element]:
    """Return track number, ticks after the cluster's timestamp, and payload of an unlaced block."""
    head = ebml.bytes(Element(block.id, block.start, min(4, block.size)))
    if len(head) < 4 or not head[0] & 0x80 or head[3] & 0x06:
        return 0, 0, block
    ticks = int.from_bytes(head[1:3], "big", signed=True)
    return head[0] & 0x7F, ticks, block._replace(start=block.start + 4, size=block.size - 4)


def _named(
    ebml: EbmlFile, elements: Iterator[Element], name: int, value: int
) -> Iterator[tuple[str, Element]]:
    """Yield the texts of the children ``name``, and the children ``value``."""
    for element in elements:
        parts = {child.id: child for child in ebml.children(element)}
        if {name, value} <= set(parts):
            yield ebml.text(parts[name]), parts[value]
