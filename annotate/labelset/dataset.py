"""A dataset: tar shards in the WebDataset layout, a manifest with their hashes, and one reader."""

import hashlib
import json
import tarfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from annotate.crop import SIZE, Crop
from annotate.frame_labels import FrameLabels
from annotate.labelset import manifests
from annotate.labelset.images import decode_depth, decode_parts, encode_parts, encode_png
from sensors.calibration_files.kinect2_factory import KINECT2_PINHOLE
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

MANIFEST = manifests.DATASET
ORDER = "order.json"
"""What the shards of a generated folder belong to, from the first one on."""
SCHEMA = 1
MAX_SHARD_BYTES = 2_000_000_000
"""Of a shard: its headers are held at once, and none is larger than the shard."""
MAX_MANIFEST_BYTES = 256_000_000
"""A million shards."""
MAX_MEMBER_BYTES = 64_000_000
"""Of an image or a frame's JSON, which are read whole."""
SUFFIXES = ("depth.png", "parts.png", "json")
"""The files of a frame, in their order; others are passed over."""
FIELDS = {"subject", "status", "notes"}
"""What a frame's JSON may hold."""
# ValueError: a member's size may have a hundred digits. RecursionError: headers of headers of headers.
_BROKEN = (OSError, tarfile.TarError, EOFError, ValueError, LookupError, RecursionError)


class Entry(NamedTuple):
    """Where a frame lies: its id, its shard and the first byte there; a label set has no shards."""

    frame_id: str
    shard: str = ""
    offset: int = 0


def encode_shard(frames: Iterable[FrameLabels]) -> bytes:
    """Frames as an uncompressed tar of ``<key>.depth.png``, ``<key>.parts.png``, ``<key>.json``.

    Owner, mode and time are fixed: the same frames give the same bytes.
    """
    shard = bytearray()
    for frame in frames:
        fields = {"subject": frame.subject, "status": frame.status, "notes": frame.notes}
        text = json.dumps(fields, sort_keys=True).encode()
        contents = encode_png(frame.depth_mm), encode_parts(frame.parts), text
        for suffix, data in zip(SUFFIXES, contents, strict=True):
            shard += _header(f"{frame.frame_id}.{suffix}", len(data)) + data
            shard += bytes(-len(data) % tarfile.BLOCKSIZE)
    shard += bytes(2 * tarfile.BLOCKSIZE)
    return bytes(shard + bytes(-len(shard) % tarfile.RECORDSIZE))


_BLANK = tarfile.TarInfo().tobuf(tarfile.USTAR_FORMAT)


def _header(name: str, size: int) -> bytes:
    """A member's header (POSIX ustar), in a twentieth of the time of a TarInfo; name: 100 bytes at most."""
    header = bytearray(_BLANK)
    header[: len(name)] = name.encode("ascii")
    header[124:135] = b"%011o" % size
    header[148:156] = b" " * 8
    header[148:155] = b"%06o\0" % sum(header)
    return bytes(header)


def read_shard(path: Path, offset: int = 0) -> Iterator[FrameLabels]:
    """Yield a shard's frames in order from a byte on. Raises FormatError when it is cut off or foreign."""
    with _opened(path, offset) as tar:
        for members in _frames(path, tar):
            yield _decoded(path, tar, members)


def entries_of(path: Path) -> Iterator[Entry]:
    """Where a shard's frames lie, in order, without decoding them. Raises FormatError as `read_shard`."""
    with _opened(path) as tar:
        for members in _frames(path, tar):
            yield Entry(_key(members), path.name, members[0].offset)


@contextmanager
def _opened(path: Path, offset: int = 0) -> Iterator[tarfile.TarFile]:
    try:
        if path.stat().st_size > MAX_SHARD_BYTES:
            raise FormatError(f"shard {path} is larger than {MAX_SHARD_BYTES} bytes; split it")
        with path.open("rb") as file:
            file.seek(offset)
            with tarfile.open(fileobj=file, mode="r:") as tar:
                yield tar
    except _BROKEN as error:
        raise FormatError(f"shard {path} cannot be read ({error}); generate it again") from error


def _frames(path: Path, tar: tarfile.TarFile) -> Iterator[list[tarfile.TarInfo]]:
    """The files of each frame; each checked before the next is looked for."""
    members: list[tarfile.TarInfo] = []
    for member in iter(tar.next, None):
        # A negative size would lead in circles.
        if not member.isfile() or not 0 <= member.size <= MAX_MEMBER_BYTES:
            raise FormatError(
                f"shard {path} holds {member.name!r}, not an image or too large; generate it again"
            )
        suffix = member.name.partition(".")[2]
        if suffix in SUFFIXES:
            members.append(member)
        if suffix == "json":
            yield members
            members = []
    if members:
        raise FormatError(f"shard {path} ends in the middle of a frame; generate it again")


def _key(members: list[tarfile.TarInfo]) -> str:
    return members[-1].name.partition(".")[0]


def _decoded(path: Path, tar: tarfile.TarFile, members: list[tarfile.TarInfo]) -> FrameLabels:
    key, data = _key(members), {}
    for member in members:
        file = tar.extractfile(member)
        data[member.name.partition(".")[2]] = file.read() if file else b""
    try:
        fields = json.loads(data["json"])
        if not isinstance(fields, dict) or not fields.keys() <= FIELDS:
            raise ValueError(f"its JSON may hold {sorted(FIELDS)} only")
        return FrameLabels(key, decode_depth(data["depth.png"]), decode_parts(data["parts.png"]), **fields)
    except (FormatError, KeyError, ValueError, TypeError, RecursionError) as error:
        raise FormatError(f"shard {path}, frame {key!r} is malformed ({error}); generate it again") from error


@dataclass(frozen=True)
class Dataset:
    """A folder of shards. shards: (file name, sha256) in order; info: the manifest's other entries.

    intrinsics: the middle of the whole image; each crop's own place is in its frame's notes.
    whole_image: the camera that synthetic images are seen by.
    """

    path: Path
    shards: tuple[tuple[str, str], ...]
    info: dict[str, Any]
    whole_image = KINECT2_PINHOLE
    intrinsics = Crop((KINECT2_PINHOLE.height - SIZE) // 2, (KINECT2_PINHOLE.width - SIZE) // 2, SIZE).camera(
        KINECT2_PINHOLE
    )

    @staticmethod
    def open(path: Path) -> "Dataset":
        """Read the manifest. Raises FormatError when there is none, it is corrupt, or shards are missing."""
        manifest = path / MANIFEST
        if not manifest.is_file():
            raise FormatError(f"{path} is not a finished dataset (it has no {MANIFEST}); generate it again")
        data = read_bounded(manifest, MAX_MANIFEST_BYTES)
        try:
            info = json.loads(data)
            if info.pop("schema") != SCHEMA:
                raise FormatError(f"{manifest} is not of schema {SCHEMA}; generate the dataset again")
            shards = tuple((str(s["file"]), str(s["sha256"])) for s in info.pop("shards"))
            info["images"] = int(info["images"])
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            raise FormatError(f"{manifest} is corrupt ({error!r}); generate the dataset again") from error
        for name, _ in shards:
            if Path(name).name != name or not (path / name).is_file():
                raise FormatError(f"{path} lacks shard {name!r} that its manifest lists; generate it again")
        return Dataset(path, shards, info)

    @property
    def source(self) -> str:
        """The folder's name."""
        return self.path.resolve().name

    @property
    def identity(self) -> dict[str, str]:
        """The manifest's hash, which covers those of the shards."""
        return {"dataset": sha256(self.path / MANIFEST)}

    def __len__(self) -> int:
        return int(self.info["images"])

    def __iter__(self) -> Iterator[FrameLabels]:
        for name, _ in self.shards:
            yield from read_shard(self.path / name)

    def entries(self) -> Iterator[Entry]:
        """Where the frames lie. Raises FormatError where a shard breaks off."""
        for name, _ in self.shards:
            yield from entries_of(self.path / name)

    def load(self, entry: Entry, persons: bool = True) -> FrameLabels:
        """The frame of an entry; datasets have no persons' numbers. Raises FormatError if it is broken."""
        return next(read_shard(self.path / entry.shard, entry.offset))


def validate(dataset: Dataset) -> list[str]:
    """Every problem of a dataset, one line each; empty when all hashes and frames are right."""
    problems = []
    for name, expected in dataset.shards:
        try:
            if sha256(dataset.path / name) != expected:
                problems.append(f"shard {name} differs from its hash in the manifest; generate it again")
            for _ in read_shard(dataset.path / name):
                pass
        except FormatError as error:
            problems.append(str(error))
    return problems


def sha256(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
