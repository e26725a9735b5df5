"""The order of names as people count: frame 2 before frame 10."""

from collections.abc import Iterable
from pathlib import Path

from natsort import natsorted


def in_order(names: Iterable[str]) -> list[str]:
    """Return the names in natural order; those that count alike (1, 01) as text."""
    plain = sorted(names)
    # Numbers of one length, as this program pads them, are in order already: natsort takes ten times as long.
    padded = len({len(name) for name in plain}) <= 1 and all(map(str.isdecimal, plain))
    return plain if padded else natsorted(plain)


def paths_in_order(paths: Iterable[Path]) -> list[Path]:
    """Return the files or folders in the natural order of their paths."""
    by_name = {str(path): path for path in paths}
    return [by_name[name] for name in in_order(by_name)]
