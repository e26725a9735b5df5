"""Measure the documentation's figures and write its pages: ``python -m tools.figures.run [--seed N]``.

``make figures`` runs this. A table that was measured with this seed and this product is not measured again,
so an interrupted run continues. The output ends with the figures that moved.
"""

import argparse
import sys

from tools.figures.pages import write_pages
from tools.figures.table import Measured, Table, changes, is_done, load, measure, product_digest
from tools.figures.tables import TABLES

SEED = 31000
"""Fresh: figures before 23 November 2026, and all tuning, used seeds below 10,000."""


def report(table: Table, measured: Measured) -> None:
    """Print a table's figures beside the figures before."""
    for row, column, old, new, is_moved in changes(table, measured):
        spec, said = table.columns[column], "MOVED" if is_moved else "as before"
        if new.text(spec) == "-":
            continue
        print(f"  {row}, {column}: {old.text(spec)} -> {new.text(spec)}: {said}")


def main() -> None:
    """Measure the chosen tables, one after another, and write the pages after each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [table.name for table in TABLES]
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="NAME", help=str(names))
    options = parser.parse_args()
    product = product_digest()
    for table in TABLES:
        if table.name not in options.only:
            continue
        if is_done(table, load(table), options.seed, product):
            print(f"{table.name}: measured already")
            continue
        if table.needs and not table.needs.is_dir():
            print(f"{table.name}: {table.needs} is absent; its figures stay")
            continue
        print(f"{table.name}: measuring", file=sys.stderr, flush=True)
        measured = measure(table, options.seed, product)
        print(f"{table.name}: {measured.cpu_s:.0f} s of CPU")
        report(table, measured)
        write_pages(TABLES)
    for path in write_pages(TABLES):
        print(f"written: {path}")


if __name__ == "__main__":
    main()
