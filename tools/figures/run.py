"""Measure the documentation's figures and write its pages: ``python -m tools.figures.run``.

``make figures`` runs this. The seed comes from the commit that is measured. A table that was measured at this
commit is not measured again, so an interrupted run continues. ``--again`` measures the working tree on the
seeds of the last measurement and prints the figures that moved. ``--seed N`` measures the working tree on a
development seed, prints the tables, and writes their worst frames to ``build/worst-frames``. Neither writes
anything else.
"""

import argparse
import sys
from collections.abc import Sequence

from sensors.errors import CloudError
from tools.figures.pages import markdown_of, said_of, write_pages
from tools.figures.table import (
    BESIDE,
    Table,
    changes,
    commit_judged,
    draw,
    is_done,
    load,
    measure,
    product_digest,
)
from tools.figures.tables import TABLES


def judge(tables: Sequence[Table]) -> None:
    """Measure tables on the seed of the commit, and write the pages after each.

    Raises CloudError if the product differs from the commit.
    """
    product = product_digest()
    commit = commit_judged(map(load, TABLES), product)
    for table in tables:
        if is_done(table, load(table), commit, product):
            print(f"{table.name}: measured already")
            continue
        measured = measure(table, commit, product)
        print(f"{table.name}: {measured.cpu_s:.0f} s of CPU", flush=True)
        write_pages(TABLES)
    for path in write_pages(TABLES):
        print(f"written: {path}")


def again(tables: Sequence[Table]) -> None:
    """Measure tables on the recordings of their last measurement; print what moved, people paired."""
    compared = count = 0
    for table in tables:
        if (old := load(table)) is None:
            print(f"{table.name}: not measured yet")
            continue
        found = changes(table, old.rows, table.measure(old.seed or 0), paired=True)
        compared += len(found)
        for one in (one for one in found if one.moved):
            spec, count = table.columns[one.column], count + 1
            print(f"{table.name}: {one.row}, {one.column}: {one.old.text(spec)} -> {one.new.text(spec)}")
    print(said_of(compared, count))


def develop(tables: Sequence[Table], seed: int) -> None:
    """Measure tables on a development seed, and print them."""
    for table in tables:
        print(
            f"{table.name}, development seed {seed}\n\n{markdown_of(table, table.measure(seed))}\n",
            flush=True,
        )
        draw(table, seed, BESIDE)


def main() -> None:
    """Measure the chosen tables, one after another."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [table.name for table in TABLES]
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--seed", type=int, help="measure on this development seed; write nothing")
    how.add_argument("--again", action="store_true", help="print what moved on the same seeds; write nothing")
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="NAME", help=str(names))
    options = parser.parse_args()
    tables = []
    for table in (table for table in TABLES if table.name in options.only):
        if table.needs and not table.needs.is_dir():
            print(f"{table.name}: {table.needs} is absent; its figures stay")
        else:
            tables.append(table)
    try:
        if options.again:
            again(tables)
        elif options.seed is not None:
            develop(tables, options.seed)
        else:
            judge(tables)
    except CloudError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
