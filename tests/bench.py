"""Runs ``bench()`` of every tests/bench_*.py and prints one table: python -m tests.bench [name ...]."""

import importlib
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table


def main(names: list[str]) -> None:
    """Benchmark the named modules (``fuse`` for bench_fuse.py), or all."""
    here = Path(__file__).resolve().parent
    modules = [f"bench_{name}" for name in names] or sorted(path.stem for path in here.glob("bench_*.py"))
    table = Table("what", "ms", "per second", "naive ms", "times faster")
    for module in modules:
        for name, seconds, naive_seconds in importlib.import_module(f"tests.{module}").bench():
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
