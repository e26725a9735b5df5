"""Names of markers and joints without what programs put in front of them."""

import re
from collections import Counter
from collections.abc import Sequence

SHARED = 0.8
"""Share of names that begin alike by which their beginning is a prefix of the file. A root or a force plate
may lack it. Untuned."""
_SIDE = re.compile(r"(left|right|l|r)", re.IGNORECASE)


def key_of(label: str) -> str:
    """Return the key of all spellings of a name: no prefix up to the last colon, no punctuation, one case."""
    return re.sub(r"[^0-9a-z]", "", label.rpartition(":")[2].casefold())


def without_prefix(labels: Sequence[str], ending: str = "") -> list[str]:
    """Return labels without what stands before a colon and without the beginning that most of them share.

    ending: characters one of which ends the prefix; "" for any prefix that is no side ("mixamorig").
    """
    plain = [label.rpartition(":")[2].strip() for label in labels]
    prefix = _shared(plain, ending)
    return [label.removeprefix(prefix) or label for label in plain]


def _shared(labels: Sequence[str], ending: str) -> str:
    """Return the longest beginning of at least ``SHARED`` of the labels that may be a prefix, "" if none."""
    beginning, most = "", max(2, SHARED * len(labels))
    while True:
        following = Counter(
            label[: len(beginning) + 1]
            for label in labels
            if len(label) > len(beginning) and label.startswith(beginning)
        )
        longer, count = max(following.items(), key=lambda pair: pair[1], default=("", 0))
        if count < most:
            break
        beginning = longer
    marks = ending or "_- ."
    prefix = beginning[: 1 + max(beginning.rfind(mark) for mark in marks)]
    if not prefix and not ending and len(beginning) >= 4:
        prefix = beginning
    return "" if _SIDE.fullmatch(prefix.strip(marks)) else prefix
