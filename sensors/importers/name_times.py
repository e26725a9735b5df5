"""Times in the names of images.

Read are numbers of milliseconds behind ``_`` (librealsense, tools/convert/converters/converter-png.hpp),
times since 1970 in seconds, milliseconds, microseconds or nanoseconds (TUM's images, ROS recorders), and
``FRAME-MICROSECONDS`` of Redwood's object scans (``0000012-000000366666``).
"""

import re
from collections.abc import Iterable

_MILLISECONDS = re.compile(r"_(\d{1,15}\.\d{1,17})$", re.ASCII)
_SINCE_1970 = re.compile(r"(?:^|[^\d.])(\d{10})(?:\.(\d{1,9})|(\d{3}|\d{6}|\d{9}))$", re.ASCII)
_REDWOOD = re.compile(r"^\d{7}-(\d{12})$", re.ASCII)
EARLIEST_S, LATEST_S = 1_000_000_000, 4_100_000_000
"""Seconds since 1970 between which a number counts as a time: the years 2001 to 2099."""


def stamps_of(names: Iterable[str]) -> dict[str, int]:
    """Return the times of names, in nanoseconds; nothing where one name has none, or two have one time."""
    found = {name: _stamp_ns(name) for name in names}
    stamps = {name: stamp for name, stamp in found.items() if stamp is not None}
    return stamps if len(set(stamps.values())) == len(found) else {}


def _stamp_ns(name: str) -> int | None:
    if at := _SINCE_1970.search(name):
        seconds, fraction = int(at[1]), at[2] or at[3] or ""
        return seconds * 10**9 + int(fraction.ljust(9, "0")) if EARLIEST_S <= seconds <= LATEST_S else None
    if at := _REDWOOD.search(name):
        return int(at[1]) * 1000
    at = _MILLISECONDS.search(name)
    return round(float(at[1]) * 1e6) if at else None
