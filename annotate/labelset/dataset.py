"""A dataset: tar shards in the WebDataset layout, a manifest with their hashes, and one reader."""

import hashlib
import io
import json
import tarfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from annotate.frame_labels import FrameLabels
from annotate.labelset.images import decode_depth, decode_parts, encode_depth, encode_parts
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

MANIFEST = "dataset.json"
SCHEMA = 1
MAX_SHARD_BYTES = 2_000_000_000
MAX_MANIFEST_BYTES = 256_000_000
"""A million shards."""
MAX_MEMBER_BYTES = 64_000_000
SUFFIXES = ("depth.png", "parts.png", "json")
"""The files of a frame, in their order; others are passed over."""
MAX_MEMBERS = 300_000
"""The ids of all are held at once."""
MAX_HEADER_BYTES = 8192
"""Of what stands before a file's own header: a long name."""
_HEADERS = (tarfile.XHDTYPE, tarfile.SOLARIS_XHDTYPE, tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK)
FIELDS = {"subject", "status", "notes"}
"""What a frame's JSON may say."""
# ValueError: a member's size may have a hundred digits. RecursionError: headers of headers of headers.
_BROKEN = (OSError, tarfile.TarError, EOFError, ValueError, LookupError, RecursionError)


def encode_shard(frames: Iterable[FrameLabels]) -> bytes:
    """Frames as an uncompressed tar of ``<key>.depth.png``, ``<key>.parts.png``, ``<key>.json``.

    Owner, mode and time are fixed: the same frames give the same bytes.
    """
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for frame in frames:
            fields = {"subject": frame.subject, "status": frame.status, "notes": frame.notes}
            for suffix, data in (
                ("depth.png", encode_depth(frame.depth_mm)),
                ("parts.png", encode_parts(frame.parts)),
                ("json", json.dumps(fields, sort_keys=True).encode()),
            ):
                member = tarfile.TarInfo(f"{frame.frame_id}.{suffix}")
                member.size = len(data)
                tar.addfile(member, io.BytesIO(data))
    return buffer.getvalue()


def read_shard(path: Path) -> Iterator[FrameLabels]:
    """Yield a shard's frames in order, sequentially. Raises FormatError when it is cut off or foreign."""
    try:
        if path.stat().st_size > MAX_SHARD_BYTES:
            raise FormatError(f"shard {path} is larger than {MAX_SHARD_BYTES} bytes; split it")
        with tarfile.open(path, mode="r:", tarinfo=_Member) as tar:
            pending: dict[str, bytes] = {}
            for member in _members(path, tar):
                key, _, suffix = member.name.partition(".")
                if suffix not in SUFFIXES:
                    continue
                file = tar.extractfile(member)
                pending[suffix] = file.read() if file else b""
                if suffix == "json":
                    yield _frame(path, key, pending)
                    pending = {}
        if pending:
            raise _ends_early(path)
    except _BROKEN as error:
        raise FormatError(f"shard {path} cannot be read ({error}); delete it and generate again") from error


def frame_ids_of(path: Path) -> list[str]:
    """Ids of a shard's frames in order, without decoding them. Raises FormatError when it cannot be read."""
    ids, whole = [], True
    try:
        with tarfile.open(path, mode="r:", tarinfo=_Member) as tar:
            for key, _, suffix in (member.name.partition(".") for member in _members(path, tar)):
                if suffix in SUFFIXES:
                    whole = suffix == "json"
                if suffix == "json":
                    ids.append(key)
        if not whole:
            raise _ends_early(path)
        return ids
    except _BROKEN as error:
        raise FormatError(f"shard {path} cannot be read ({error}); delete it and generate again") from error


class _Member(tarfile.TarInfo):
    """A header of a shard, refused before ``tarfile`` reads what it announces."""

    # Every header passes here in every Python; in newer ones not through the public ``frombuf`` any more.
    def _proc_member(self, tar: tarfile.TarFile) -> tarfile.TarInfo:
        """Raises ReadError for what ``tarfile`` copies to all members, reads on and on, or is long."""
        if self.type == tarfile.XGLTYPE:
            raise tarfile.ReadError("it has a header for all files")
        if self.type == tarfile.GNUTYPE_SPARSE:
            raise tarfile.ReadError("it holds a sparse file")
        if self.type in _HEADERS and not 0 <= self.size <= MAX_HEADER_BYTES:
            raise tarfile.ReadError(f"a header has {self.size} bytes")
        member: tarfile.TarInfo = super()._proc_member(tar)  # type: ignore[misc]
        return member


def _members(path: Path, tar: tarfile.TarFile) -> Iterator[tarfile.TarInfo]:
    """A shard's files, each checked before the next is looked for: a negative size would lead in circles."""
    for number, member in enumerate(iter(tar.next, None)):
        if number >= MAX_MEMBERS:
            raise FormatError(f"shard {path} holds more than {MAX_MEMBERS} files; split it")
        if not member.isfile() or member.issparse() or not 0 <= member.size <= MAX_MEMBER_BYTES:
            raise FormatError(
                f"shard {path} holds {member.name!r}, not an image or too large; delete it and generate again"
            )
        yield member
        # It remembers each, with its headers.
        tar.members.clear()  # type: ignore[attr-defined]


def _ends_early(path: Path) -> FormatError:
    return FormatError(f"shard {path} ends in the middle of a frame; delete it and generate again")


def _frame(path: Path, key: str, data: dict[str, bytes]) -> FrameLabels:
    try:
        fields = json.loads(data["json"])
        if not isinstance(fields, dict) or not fields.keys() <= FIELDS:
            raise ValueError(f"its JSON may hold {sorted(FIELDS)} only")
        return FrameLabels(key, decode_depth(data["depth.png"]), decode_parts(data["parts.png"]), **fields)
    except (FormatError, KeyError, ValueError, TypeError, RecursionError) as error:
        raise FormatError(
            f"shard {path}, frame {key!r} is malformed ({error}); delete it and generate again"
        ) from error


@dataclass(frozen=True)
class Dataset:
    """A folder of shards. shards: (file name, sha256) in order; info: the manifest's other entries."""

    path: Path
    shards: tuple[tuple[str, str], ...]
    info: dict[str, Any]

    @staticmethod
    def open(path: Path) -> "Dataset":
        """Read the manifest. Raises FormatError when there is none, it is corrupt, or shards are missing."""
        manifest = path / MANIFEST
        if not manifest.is_file():
            raise FormatError(
                f"{path} is not a finished dataset (it has no {MANIFEST}); run 'synth generate' again"
            )
        data = read_bounded(manifest, MAX_MANIFEST_BYTES)
        try:
            info = json.loads(data)
            if info.pop("schema") != SCHEMA:
                raise FormatError(f"{manifest} is not of schema {SCHEMA}; generate the dataset again")
            shards = tuple((str(s["file"]), str(s["sha256"])) for s in info.pop("shards"))
            info["images"] = int(info["images"])
        except (
            ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError,
        ) as error:  # fmt: skip
            raise FormatError(f"{manifest} is corrupt ({error!r}); generate the dataset again") from error
        for name, _ in shards:
            if Path(name).name != name or not (path / name).is_file():
                raise FormatError(
                    f"{path} lacks shard {name!r} that its manifest lists; run 'synth generate' again"
                )
        return Dataset(path, shards, info)

    def __iter__(self) -> Iterator[FrameLabels]:
        for name, _ in self.shards:
            yield from read_shard(self.path / name)

    def __len__(self) -> int:
        return int(self.info["images"])


def validate(dataset: Dataset) -> list[str]:
    """Every problem of a dataset, one line each; empty when all hashes and frames are right."""
    problems = []
    for name, expected in dataset.shards:
        try:
            if sha256(dataset.path / name) != expected:
                problems.append(
                    f"shard {name} differs from its hash in the manifest; delete it and generate again"
                )
            for _ in read_shard(dataset.path / name):
                pass
        except FormatError as error:
            problems.append(str(error))
    return problems


def sha256(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
