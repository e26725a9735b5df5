"""Runs ``bench()`` of every bench/*.py and prints one table: python -m bench.all [name ...]."""

import importlib
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table


def main(names: list[str]) -> None:
    """Benchmark the named modules (``fuse`` for bench/fuse.py), or all."""
    here = Path(__file__).resolve().parent
    modules = names or sorted(path.stem for path in here.glob("*.py") if path.stem != "all")
    table = Table("what", "ms", "per second", "naive ms", "times faster")
    for module in modules:
        for name, seconds, naive_seconds in importlib.import_module(f"bench.{module}").bench():
            table.add_row(
                name,
                f"{seconds * 1e3:.2f}",
                f"{1 / seconds:.0f}",
                f"{naive_seconds * 1e3:.2f}",
                f"{naive_seconds / seconds:.1f}",
            )
    Console().print(table)


if __name__ == "__main__":
    main(sys.argv[1:])
