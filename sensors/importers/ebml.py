"""The elements of an EBML file (Matroska's container, RFC 8794), each bounded by its parent and the file.

Only elements that raw video needs: no codec, no index, no lacing.
"""

import os
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

from sensors.errors import FormatError

MAX_ELEMENT_BYTES = 1 << 26  # room for a 4096x3072 image of 16 bits; untuned


class Element(NamedTuple):
    """Element: its id (marker bits included), and position and length of its payload.

    cut: True if its parent ends earlier, as at the end of a truncated file.
    """

    id: int
    start: int
    size: int
    cut: bool = False

    @property
    def end(self) -> int:
        """Return the offset of the byte after the element."""
        return self.start + self.size


class EbmlFile:
    """File open for reading as EBML. Raises FormatError for elements that are too large.

    cut: True after an element that ends later than its parent, or has a truncated head.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file, self.cut = file, False
        self.whole = Element(0, 0, os.fstat(file.fileno()).st_size)

    def children(self, parent: Element) -> Iterator[Element]:
        """Yield elements within ``parent``; one of unknown size, or cut off, reaches to its parent's end."""
        offset = parent.start
        while offset < parent.end and (element := self._element(offset, parent.end)) is not None:
            yield element
            offset = element.end

    def find(self, parent: Element, *path: int) -> Iterator[Element]:
        """Yield every element at the end of a path of ids below ``parent``."""
        for child in self.children(parent):
            if child.id == path[0]:
                yield from self.find(child, *path[1:]) if path[1:] else (child,)

    def bytes(self, element: Element, limit: int = MAX_ELEMENT_BYTES) -> bytes:
        """Return an element's payload."""
        if element.size > limit:
            name = self._file.name
            raise FormatError(
                f"{name} is damaged (an element has {element.size} bytes, at most {limit} are possible); "
                "restore it from a copy"
            )
        self._file.seek(element.start)
        return self._file.read(element.size)

    def number(self, element: Element) -> int:
        """Return an unsigned integer of at most 8 bytes."""
        return int.from_bytes(self.bytes(element, 8), "big")

    def text(self, element: Element) -> str:
        """Return a short string, zero padding removed."""
        return self.bytes(element).rstrip(b"\0").decode("utf-8", "replace")

    def _element(self, offset: int, end: int) -> Element | None:
        self._file.seek(offset)
        head = self._file.read(12)
        id_length = _length(head, 4)
        size_length = _length(head[id_length:], 8) if id_length else 0
        start = offset + id_length + size_length
        if not size_length or start > end:
            self.cut = True
            return None
        unknown = (1 << 7 * size_length) - 1  # RFC 8794, 6.2
        size = int.from_bytes(head[id_length : id_length + size_length], "big") & unknown
        size = end - start if size == unknown else size
        cut = size > end - start
        self.cut |= cut
        return Element(int.from_bytes(head[:id_length], "big"), start, min(size, end - start), cut)


def _length(head: bytes, longest: int) -> int:
    """Return the length in bytes of the variable-size integer that begins here; 0 for an invalid one."""
    length = 9 - head[0].bit_length() if head else 0
    return length if 0 < length <= min(longest, len(head)) else 0
