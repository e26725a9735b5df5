"""A reader's files, spoilt: mutations, sums set right again behind them, and what the reader says."""

import random
import shutil
import struct
import traceback
import warnings
from pathlib import Path
from zlib import crc32

from sensors.errors import CloudError
from sensors.files.png import PNG_MAGIC
from tools.fuzz_samples import Reader

NUMBERS = (
    b"0",
    b"-1",
    b"1e309",
    b"nan",
    b"4294967296",
    b"99999999999999999999",
    b"null",
    b"[]",
    b'"../../x"',
)
_TAR_BLOCK, _TAR_SUM = 512, slice(148, 156)


def mutate(data: bytes, rng: random.Random) -> bytes:
    """A few random changes: bits, bytes, numbers in text, pieces cut out, doubled, moved; the end cut off."""
    content = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        at, length = rng.randrange(len(content) + 1), rng.choice((1, 2, 4, 8, rng.randrange(1, 200)))
        match rng.randrange(8):
            case 0 | 1 if content:
                content[at % len(content)] ^= 1 << rng.randrange(8)
            case 2 if content:
                content[at % len(content)] = rng.choice((0, 1, 0x7F, 0x80, 0xFF))
            case 3:
                content[at : at + length] = rng.choice((b"\xff", b"\0", b"\x7f")) * length
            case 4:
                del content[at:]
            case 5:
                del content[at : at + length]
            case 6:
                begin = rng.randrange(len(content) + 1)
                content[at:at] = content[begin : begin + length]
            case _:
                _renumber(content, rng)
    return bytes(content)


def _renumber(content: bytearray, rng: random.Random) -> None:
    """Replace a run of digits, from a random place on, by a number nobody expects."""
    begin = rng.randrange(len(content) + 1)
    digits = next((i for i in range(begin, min(len(content), begin + 2000)) if 48 <= content[i] <= 57), None)
    if digits is not None:
        end = digits
        while end < len(content) and 48 <= content[end] <= 57:
            end += 1
        content[digits:end] = rng.choice(NUMBERS)


def seal(data: bytes) -> bytes:
    """Set right the sums of what was spoilt, as a hostile author would: tar headers, the chunks of PNGs."""
    content = bytearray(data)
    if content[257:262] == b"ustar":
        _seal_tar(content)
    begin = content.find(PNG_MAGIC)
    while begin >= 0:
        _seal_png(content, begin + len(PNG_MAGIC))
        begin = content.find(PNG_MAGIC, begin + 1)
    return bytes(content)


def _seal_tar(content: bytearray) -> None:
    offset = 0
    while offset + _TAR_BLOCK <= len(content) and content[offset]:
        header = content[offset : offset + _TAR_BLOCK]
        header[_TAR_SUM] = b" " * 8
        header[_TAR_SUM] = b"%06o\0 " % sum(header)
        content[offset : offset + _TAR_BLOCK] = header
        digits = bytes(header[124:136]).strip(b" \0")
        size = int(digits, 8) if digits and all(48 <= digit < 56 for digit in digits) else 0
        offset += _TAR_BLOCK * (1 + -(-size // _TAR_BLOCK))


def _seal_png(content: bytearray, offset: int) -> None:
    kind = b""
    while offset + 12 <= len(content) and kind != b"IEND":
        (length,) = struct.unpack_from(">I", content, offset)
        kind, end = content[offset + 4 : offset + 8], offset + 8 + length
        if end + 4 > len(content):
            return
        struct.pack_into(">I", content, end, crc32(content[offset + 4 : end]))
        offset = end + 4


class Fuzzer:
    """One reader's samples in a folder: the good one, and a copy of it that is spoilt anew every time."""

    def __init__(self, reader: Reader, root: Path) -> None:
        self._read = reader.read
        good, self.spoilt = root / "good", root / "spoilt"
        good.mkdir()
        made = reader.make(good)
        reader.read(made)
        self._target = self.spoilt / made.relative_to(good)
        files = (file for file in sorted(good.rglob("*")) if file.is_file())
        self.files = {file.relative_to(good): file.read_bytes() for file in files}
        shutil.copytree(good, self.spoilt)
        self._changed: dict[Path, bytes] = {}

    def spoil(self, seed: object) -> None:
        """Spoil one file, now and then two, at random, with right sums every other time."""
        rng = random.Random(str(seed))
        chosen = rng.sample(sorted(self.files), k=min(len(self.files), rng.choice((1, 1, 1, 2))))
        changed = {name: mutate(self.files[name], rng) for name in chosen}
        self.put({name: seal(data) for name, data in changed.items()} if rng.random() < 0.5 else changed)

    def put(self, changed: dict[Path, bytes]) -> None:
        """Write these contents; all other files are whole again."""
        again = {name: self.files[name] for name in self._changed}
        for name, data in {**again, **changed}.items():
            (self.spoilt / name).write_bytes(data)
        self._changed = changed

    def finding(self) -> str:
        """Read what is spoilt; "" when it goes well or is refused in one line, else what happened."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self._read(self._target)
        except CloudError as error:
            return "" if str(error).isprintable() else f"message of several lines: {error!r}"
        except BaseException:
            return traceback.format_exc()
        return ""
