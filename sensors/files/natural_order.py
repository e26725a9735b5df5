"""Natural order of names: frame 2 before frame 10."""

from collections.abc import Iterable
from pathlib import Path

from natsort import natsorted


def in_order(names: Iterable[str]) -> list[str]:
    """Return the names in natural order; equal numbers (1, 01) in the order of their text."""
    plain = sorted(names)
    padded = len({len(name) for name in plain}) <= 1 and all(map(str.isdecimal, plain))
    return plain if padded else natsorted(plain)  # natsort takes ten times as long


def paths_in_order(paths: Iterable[Path]) -> list[Path]:
    """Return the files or folders in the natural order of their paths."""
    by_name = {str(path): path for path in paths}
    return [by_name[name] for name in in_order(by_name)]
