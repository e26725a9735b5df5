"""Dataset: tar shards in the WebDataset layout, and a manifest with their hashes."""

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
from annotate.labelset.images import decode_depth, decode_parts, encode_parts, encode_png
from annotate.labelset.scheme_note import scheme_in
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from sensors.calibration_files.kinect2_factory import KINECT2_PINHOLE
from sensors.errors import FormatError, fault_of
from sensors.files.bounded import read_bounded

MANIFEST = "dataset.json"
ORDER = "order.json"
"""Description of a generated folder, from its first shard on."""
SCHEMA = 1
MAX_SHARD_BYTES = 2_000_000_000  # because its headers are held at once, none larger than the shard
MAX_MANIFEST_BYTES = 256_000_000  # a million shards
MAX_MEMBER_BYTES = 64_000_000  # of an image or a frame's JSON
SUFFIXES = ("depth.png", "parts.png", "json")
"""Files of a frame, in their order; others are passed over."""
FIELDS = {"subject", "status", "notes"}
"""Allowed keys of a frame's JSON."""
# ValueError: a member's size may have a hundred digits. RecursionError: headers of headers of headers.
_BROKEN = (OSError, tarfile.TarError, EOFError, ValueError, LookupError, RecursionError)


class Entry(NamedTuple):
    """Position of a frame: id, shard and first byte; a label set has no shards."""

    frame_id: str
    shard: str = ""
    offset: int = 0


def encode_shard(frames: Iterable[FrameLabels]) -> bytes:
    """Encode frames as an uncompressed tar: ``<key>.depth.png``, ``<key>.parts.png``, ``<key>.json``.

    Deterministic. The frames' scheme is for the manifest (``scheme_note``), not in the shard.
    """
    shard = bytearray()
    for frame in frames:
        fields = {"subject": frame.subject, "status": frame.status, "notes": frame.notes}
        text = json.dumps(fields, sort_keys=True).encode()
        contents = encode_png(frame.depth_mm), encode_parts(frame.parts, frame.scheme), text
        for suffix, data in zip(SUFFIXES, contents, strict=True):
            header = tarfile.TarInfo(f"{frame.frame_id}.{suffix}")
            header.size = len(data)
            shard += header.tobuf(tarfile.USTAR_FORMAT) + data
            shard += bytes(-len(data) % tarfile.BLOCKSIZE)
    shard += bytes(2 * tarfile.BLOCKSIZE)
    return bytes(shard + bytes(-len(shard) % tarfile.RECORDSIZE))


def read_shard(path: Path, offset: int = 0, scheme: Scheme = PAPER) -> Iterator[FrameLabels]:
    """Yield a shard's frames in order, from byte ``offset`` on. scheme: of the frames.

    Raises FormatError for a truncated file, or one that is not a shard.
    """
    with _opened(path, offset) as tar:
        for members in _frames(path, tar):
            yield _decoded(path, tar, members, scheme)


def entries_of(path: Path) -> Iterator[Entry]:
    """Yield the ``Entry`` of each frame of a shard, without decoding. Raises FormatError as
    ``read_shard``.
    """
    with _opened(path) as tar:
        for members in _frames(path, tar):
            yield Entry(_key(members), path.name, members[0].offset)


@contextmanager
def _opened(path: Path, offset: int = 0) -> Iterator[tarfile.TarFile]:
    try:
        if path.stat().st_size > MAX_SHARD_BYTES:
            raise FormatError(f"shard {path} is larger than {MAX_SHARD_BYTES} bytes; generate it again")
        with path.open("rb") as file:
            file.seek(offset)
            with tarfile.open(fileobj=file, mode="r:") as tar:
                yield tar
    except _BROKEN as error:
        raise FormatError(f"shard {path} cannot be read ({error}); generate it again") from error


def _frames(path: Path, tar: tarfile.TarFile) -> Iterator[list[tarfile.TarInfo]]:
    """Yield the tar members of each frame."""
    members: list[tarfile.TarInfo] = []
    for member in iter(tar.next, None):
        # A negative size would lead in circles.
        if not member.isfile():
            raise FormatError(f"shard {path} holds {member.name!r}, which is not a file; generate it again")
        if not 0 <= member.size <= MAX_MEMBER_BYTES:
            raise FormatError(
                f"shard {path} holds {member.name!r} of {member.size} bytes, over {MAX_MEMBER_BYTES}; "
                "generate it again"
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


def _decoded(path: Path, tar: tarfile.TarFile, members: list[tarfile.TarInfo], scheme: Scheme) -> FrameLabels:
    key, data = _key(members), {}
    for member in members:
        file = tar.extractfile(member)
        data[member.name.partition(".")[2]] = file.read() if file else b""
    try:
        fields = json.loads(data["json"])
        if not isinstance(fields, dict) or not fields.keys() <= FIELDS:
            raise ValueError(f"its JSON may hold {', '.join(sorted(FIELDS))} only")
        depth_mm, parts = decode_depth(data["depth.png"]), decode_parts(data["parts.png"])
        return FrameLabels(key, depth_mm, parts, scheme=scheme, **fields)
    except (FormatError, KeyError, ValueError, TypeError, RecursionError) as error:
        why = f"it lacks {error}" if isinstance(error, KeyError) else fault_of(error)
        raise FormatError(f"shard {path}, frame {key!r} is malformed ({why}); generate it again") from error


@dataclass(frozen=True)
class Dataset:
    """Folder of shards.

    shards: (file name, sha256) in order; info: the manifest's other entries. scheme: of all frames.
    whole_image: camera of the synthetic images. intrinsics: camera of a crop in their middle; each frame's
    notes hold its crop.
    """

    path: Path
    shards: tuple[tuple[str, str], ...]
    info: dict[str, Any]
    scheme: Scheme = PAPER
    whole_image = KINECT2_PINHOLE
    intrinsics = Crop((KINECT2_PINHOLE.height - SIZE) // 2, (KINECT2_PINHOLE.width - SIZE) // 2, SIZE).camera(
        KINECT2_PINHOLE
    )

    @staticmethod
    def open(path: Path) -> "Dataset":
        """Open a dataset. Raises FormatError when its manifest is absent or corrupt, or shards are
        missing.
        """
        manifest = path / MANIFEST
        if not manifest.exists():
            raise FormatError(f"{path} is not a finished dataset (it has no {MANIFEST}); generate it again")
        data = read_bounded(manifest, MAX_MANIFEST_BYTES)
        try:
            info = json.loads(data)
            if (held := info.pop("schema")) != SCHEMA:
                raise FormatError(
                    f"{manifest} has schema {held!r:.9}, not {SCHEMA}; generate the dataset again"
                )
            shards = tuple((str(s["file"]), str(s["sha256"])) for s in info.pop("shards"))
            info["images"] = int(info["images"])
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            why = fault_of(error)
            raise FormatError(f"{manifest} is corrupt ({why}); generate the dataset again") from error
        scheme = scheme_in(info, manifest)
        for name, _ in shards:
            if Path(name).name != name or not (path / name).is_file():
                raise FormatError(f"{path} lacks shard {name!r} that its manifest lists; generate it again")
        return Dataset(path, shards, info, scheme)

    @property
    def source(self) -> str:
        return self.path.resolve().name

    @property
    def identity(self) -> dict[str, str]:
        """Return the hash of the manifest, which covers the shards' hashes."""
        return {"dataset": sha256(self.path / MANIFEST)}

    def __len__(self) -> int:
        return int(self.info["images"])

    def __iter__(self) -> Iterator[FrameLabels]:
        for name, _ in self.shards:
            yield from read_shard(self.path / name, scheme=self.scheme)

    def entries(self) -> Iterator[Entry]:
        """Yield the ``Entry`` of each frame. Raises FormatError for a broken shard."""
        for name, _ in self.shards:
            yield from entries_of(self.path / name)

    def load(self, entry: Entry, persons: bool = True) -> FrameLabels:
        """Read the frame of an entry; datasets hold no persons' images. Raises FormatError for a broken
        shard.
        """
        return next(read_shard(self.path / entry.shard, entry.offset, self.scheme))


def validate(dataset: Dataset) -> list[str]:
    """Return every problem of a dataset, one line each."""
    problems = []
    for name, expected in dataset.shards:
        try:
            if sha256(dataset.path / name) != expected:
                problems.append(f"shard {name} differs from its hash in the manifest; generate it again")
            for _ in read_shard(dataset.path / name, scheme=dataset.scheme):
                pass
        except FormatError as error:
            problems.append(str(error))
    return problems


def sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
