"""What ``info`` shows of the corrections in a label set."""

from annotate.correction.audit import Audit, PersonWork, audit
from annotate.labelset.journal import Journal
from annotate.labelset.store import LabelSet
from cli.console import table


def audit_of(labels: LabelSet) -> Audit | None:
    """The audit of a label set, or None if nobody corrected it."""
    found = audit(labels, Journal.of(labels.path))
    return found if found.people else None


def audit_text(found: Audit) -> str:
    """Tables: one row for each person, then for each person one row for each part; rejected frames last."""
    tables = [_people(found), *(_parts(person) for person in found.people if person.parts)]
    rejected = [f"rejected {frame_id}: {reason}" for frame_id, reason in found.rejected.items()]
    return "\n\n".join([*tables, *rejected])


def _people(found: Audit) -> str:
    names = ("person", "frames", "accepted", "untouched", "s median", "s p90", "strokes", "undos", "changed")
    rows = [
        (
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
        for person in found.people
    ]
    return table(names, rows, "Corrections")


def _parts(person: PersonWork) -> str:
    rows = [
        (name, work.strokes, f"{work.seconds:.1f}", work.gained_px, work.lost_px)
        for name, work in person.parts.items()
    ]
    return table(("part", "strokes", "seconds", "px gained", "px lost"), rows, f"Parts, {person.who}")
