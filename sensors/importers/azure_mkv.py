"""A recording of Microsoft's ``k4arecorder`` (Azure Kinect, Matroska) as a source of frames.

Depth and infrared are raw big-endian 16-bit images, colour is the camera's own JPEG, so no codec is needed.
Format: Azure Kinect DK documentation, "Azure Kinect DK recording file format".
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.errors import CalibrationError, FormatError
from sensors.importers.azure_calibration import calibration_from_factory
from sensors.importers.ebml import EbmlFile, Element
from sensors.rig.frame import RigFrame
from sensors.rig.pairing import COLOR_WINDOW_NS, pair_stamps

EBML, SEGMENT, INFO, SCALE = 0x1A45DFA3, 0x18538067, 0x1549A966, 0x2AD7B1
TRACKS, TRACK, NUMBER, NAME, PRIVATE = 0x1654AE6B, 0xAE, 0xD7, 0x536E, 0x63A2
ATTACHMENTS, ATTACHED, FILE_NAME, FILE_DATA = 0x1941A469, 0x61A7, 0x466E, 0x465C
TAGS, TAG, SIMPLE_TAG, TAG_NAME, TAG_STRING = 0x1254C367, 0x7373, 0x67C8, 0x45A3, 0x4487
CLUSTER, TIMESTAMP, SIMPLE_BLOCK, BLOCK_GROUP, BLOCK = 0x1F43B675, 0xE7, 0xA3, 0xA0, 0xA1
"""Ids of the Matroska specification, RFC 9559."""

DEFAULT_SCALE_NS = 1_000_000
DEPTH, COLOR, INFRARED = "DEPTH", "COLOR", "IR"
WANTED = {DEPTH: b"b16g", COLOR: b"MJPG", INFRARED: b"b16g"}
"""Tracks that are read, and the only pixel format of each that is."""


class Track(NamedTuple):
    """One video track: what its images are. fourcc: the pixel format of its BITMAPINFOHEADER."""

    name: str
    width: int
    height: int
    fourcc: bytes


class Blocks(NamedTuple):
    """Where the images of one track lie. stamps_ns: when they were taken, on the recording's clock."""

    stamps_ns: list[int]
    payloads: list[Element]


class AzureRecording:
    """An Azure Kinect recording as a ``FrameSource``; depth is master, images are read one at a time.

    notes: what is absent, where the calibration is from. Raises FormatError for what is no such recording,
    CalibrationError when its calibration is missing or unknown.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.stem
        try:
            with path.open("rb") as file:
                self._scan(EbmlFile(file))
        except OSError as error:
            raise FormatError(f"{path} cannot be read ({error.strerror}); give a recording") from error
        self._color = self._paired(COLOR, COLOR_WINDOW_NS)
        self._infrared = self._paired(INFRARED, 0)

    def __len__(self) -> int:
        return len(self._blocks[DEPTH].stamps_ns)

    def __iter__(self) -> Iterator[RigFrame]:
        with self.path.open("rb") as file:
            ebml = EbmlFile(file)
            for index in range(len(self)):
                yield self._frame(ebml, index)

    @property
    def notes(self) -> tuple[str, ...]:
        """What is absent or assumed, one sentence each."""
        size = self.calibration.depth
        pairs = {"colour": self._color, "infrared": self._infrared}
        absent = [f"no {name} images" for name, indices in pairs.items() if not (indices >= 0).any()]
        return (
            f"intrinsics and poses from the camera's own calibration.json, for {self._mode} at "
            f"{size.width}x{size.height}",
            *absent,
            *self._left_out,
            "no thermal images",
        )

    def _scan(self, ebml: EbmlFile) -> None:
        if next(ebml.children(ebml.whole), Element(0, 0, 0)).id != EBML:
            raise FormatError(f"{self.path} is not a Matroska file; give a recording of k4arecorder")
        segment = next(ebml.find(ebml.whole, SEGMENT), Element(0, 0, 0))
        tracks = _tracks(ebml, segment)
        if DEPTH not in {track.name for track in tracks.values()}:
            raise FormatError(f"{self.path} has no DEPTH track; give an Azure Kinect recording with depth")
        self._left_out = tuple(
            f"{track.name} images are {track.fourcc.decode('ascii', 'replace')!r}: left out"
            for track in tracks.values()
            if track.name in WANTED and track.fourcc != WANTED[track.name]
        )
        tracks = {n: track for n, track in tracks.items() if WANTED.get(track.name) == track.fourcc}
        self._tracks = {track.name: track for track in tracks.values()}
        self._blocks = _blocks(ebml, segment, {number: track.name for number, track in tracks.items()})
        tags = _tags(ebml, segment)
        self._mode = tags.get("K4A_DEPTH_MODE", "")
        depth, color = self._tracks.get(DEPTH), self._tracks.get(COLOR)
        if depth is None or not self._blocks[DEPTH].stamps_ns:
            raise FormatError(f"{self.path} holds no readable depth image; record with a depth mode")
        self.calibration = calibration_from_factory(
            _attachment(ebml, segment, tags.get("K4A_CALIBRATION_FILE", "calibration.json")),
            (depth.width, depth.height),
            (color.width, color.height) if color else None,
            self._mode,
        )

    def _paired(self, name: str, window_ns: int) -> NDArray[np.int64]:
        stamps = [np.array(self._blocks[track].stamps_ns, np.int64) for track in (DEPTH, name)]
        return pair_stamps(stamps[0], stamps[1], window_ns)

    def _frame(self, ebml: EbmlFile, index: int) -> RigFrame:
        color, infrared = int(self._color[index]), int(self._infrared[index])
        return RigFrame(
            index=index,
            stamp_ns=self._blocks[DEPTH].stamps_ns[index],
            depth_mm=self._grey(ebml, DEPTH, index),
            color_encoded=ebml.bytes(self._blocks[COLOR].payloads[color]) if color >= 0 else None,
            infrared=self._grey(ebml, INFRARED, infrared) if infrared >= 0 else None,
        )

    def _grey(self, ebml: EbmlFile, name: str, index: int) -> NDArray[np.uint16]:
        track, payload = self._tracks[name], self._blocks[name].payloads[index]
        if payload.size != 2 * track.width * track.height:
            raise FormatError(
                f"{self.path}: {name} image {index} has {payload.size} bytes, not "
                f"{track.width}x{track.height} of 16 bits; record it again"
            )
        values = np.frombuffer(ebml.bytes(payload), ">u2").astype(np.uint16)
        return values.reshape(track.height, track.width)


def _tracks(ebml: EbmlFile, segment: Element) -> dict[int, Track]:
    tracks = {}
    for entry in ebml.find(segment, TRACKS, TRACK):
        parts = {child.id: child for child in ebml.children(entry)}
        if {NUMBER, NAME, PRIVATE} <= set(parts):
            # BITMAPINFOHEADER: size, width, height, planes, bits, compression, ...
            header = ebml.bytes(parts[PRIVATE])
            width, height = (int.from_bytes(header[at : at + 4], "little") for at in (4, 8))
            track = Track(ebml.text(parts[NAME]), width, height, header[16:20])
            tracks[ebml.number(parts[NUMBER])] = track
    return tracks


def _blocks(ebml: EbmlFile, segment: Element, names: dict[int, str]) -> dict[str, Blocks]:
    """The images of these tracks (number -> name), sorted by stamp; those cut off at the end left out."""
    scale = next(map(ebml.number, ebml.find(segment, INFO, SCALE)), DEFAULT_SCALE_NS)
    found: dict[str, list[tuple[int, Element]]] = {name: [] for name in WANTED}
    for cluster in ebml.find(segment, CLUSTER):
        start = 0
        for child in ebml.children(cluster):
            if child.id == TIMESTAMP:
                start = ebml.number(child)
            grouped = ebml.find(child, BLOCK) if child.id == BLOCK_GROUP else ()
            for block in (child,) if child.id == SIMPLE_BLOCK else grouped:
                number, ticks, payload = _block(ebml, block)
                stamp_ns = (start + ticks) * scale
                if number in names and 0 <= stamp_ns < 1 << 62:
                    found[names[number]].append((stamp_ns, payload))
    result = {}
    for name, blocks in found.items():
        blocks.sort(key=lambda block: block[0])
        result[name] = Blocks([stamp for stamp, _ in blocks], [payload for _, payload in blocks])
    return result


def _block(ebml: EbmlFile, block: Element) -> tuple[int, int, Element]:
    """Track number, ticks after the cluster's timestamp, and payload of an unlaced block."""
    head = ebml.bytes(Element(block.id, block.start, min(4, block.size)))
    if len(head) < 4 or not head[0] & 0x80 or head[3] & 0x06:
        return 0, 0, block
    ticks = int.from_bytes(head[1:3], "big", signed=True)
    return head[0] & 0x7F, ticks, Element(block.id, block.start + 4, block.size - 4)


def _tags(ebml: EbmlFile, segment: Element) -> dict[str, str]:
    tags = {}
    for tag in ebml.find(segment, TAGS, TAG, SIMPLE_TAG):
        parts = {child.id: child for child in ebml.children(tag)}
        if {TAG_NAME, TAG_STRING} <= set(parts):
            tags[ebml.text(parts[TAG_NAME])] = ebml.text(parts[TAG_STRING])
    return tags


def _attachment(ebml: EbmlFile, segment: Element, name: str) -> bytes:
    for attached in ebml.find(segment, ATTACHMENTS, ATTACHED):
        parts = {child.id: child for child in ebml.children(attached)}
        if {FILE_NAME, FILE_DATA} <= set(parts) and ebml.text(parts[FILE_NAME]) == name:
            return ebml.bytes(parts[FILE_DATA])
    raise CalibrationError(f"the recording has no attachment {name[:60]!r}; record it with k4arecorder")
