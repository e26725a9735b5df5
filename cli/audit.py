"""What ``info`` shows of the corrections in a label set."""

from rich.console import Console
from rich.table import Table
from rich.text import Text

from annotate.correction.audit import Audit, PersonWork, audit
from annotate.labelset.journal import Journal
from annotate.labelset.store import LabelSet


def audit_of(labels: LabelSet) -> Audit | None:
    """The audit of a label set, or None if nobody corrected it."""
    found = audit(labels, Journal.of(labels.path))
    return found if found.people else None


def audit_text(found: Audit) -> str:
    """Tables: one of the people, and for each of them one of the parts; then what stands rejected."""
    console = Console(width=110, no_color=True, highlight=False)
    with console.capture() as captured:
        console.print(_people(found))
        for person in found.people:
            if person.parts:
                console.print(_parts(person))
        for frame_id, reason in found.rejected.items():
            console.print(Text(f"rejected {frame_id}: {reason}"))
    return captured.get().rstrip("\n")


def _people(found: Audit) -> Table:
    table = Table("person", title="Work", title_justify="left")
    for column in ("frames", "accepted", "untouched", "s median", "s p90", "strokes", "undos", "changed"):
        table.add_column(column, justify="right")
    for person in found.people:
        _row(
            table,
            person.who,
            person.frames,
            person.accepted,
            f"{person.accepted_untouched:.0%}",
            f"{person.seconds_median:.1f}",
            f"{person.seconds_p90:.1f}",
            person.strokes,
            person.undos,
            f"{person.changed:.1%}",
        )
    return table


def _parts(person: PersonWork) -> Table:
    table = Table("part", title=Text(f"Parts, {person.who}"), title_justify="left")
    for column in ("strokes", "seconds", "px gained", "px lost"):
        table.add_column(column, justify="right")
    for name, work in person.parts.items():
        _row(table, name, work.strokes, f"{work.seconds:.1f}", work.gained_px, work.lost_px)
    return table


def _row(table: Table, *cells: object) -> None:
    # Names come from outside: as Text they cannot be markup.
    table.add_row(*(Text(str(cell)) for cell in cells))
