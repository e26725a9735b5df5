"""``info`` of a label set: its states and parts, and the work of each person on it."""

from collections import Counter
from typing import TYPE_CHECKING, Any

from cli.console import facts, table

if TYPE_CHECKING:
    from annotate.correction.audit import Audit, PersonWork
    from annotate.labelset.journal import Journal
    from annotate.labelset.label_set import LabelSet


def labels_info(labels: "LabelSet") -> tuple[dict[str, Any], str]:
    """Return the contents of a label set, as JSON, and as lines for people."""
    from annotate.correction.audit import audit
    from annotate.labelset.journal import Journal

    journal, frames = Journal.of(labels.path), len(labels.frame_ids)
    states, pixels = _counted(labels, journal)
    result: dict[str, Any] = {
        "kind": "label set",
        "frames": frames,
        "states": states,
        "pixels": pixels,
        "source": labels.info.get("source", ""),
        "steps": labels.info.get("steps", {}),
    }
    short = {**result, "steps": list(result["steps"])}
    texts = [
        facts({name: value for name, value in short.items() if name != "pixels"}),
        table(("part", "pixels per frame"), [(part, n / max(1, frames)) for part, n in pixels.items()]),
    ]
    if journal and (found := audit(labels, journal)).people:
        result["audit"] = found.to_json()
        texts.append(_audit_text(found))
    return result, "\n\n".join(texts)


def _counted(labels: "LabelSet", journal: "Journal") -> tuple[dict[str, int], dict[str, int]]:
    """Return the number of frames by state, and of pixels by part."""
    import numpy as np

    from annotate.correction.replay import STATE_NAMES, state_of
    from annotate.parts import PARTS

    states, pixels = Counter[str](), np.zeros(256, np.int64)
    for frame_id in labels.frame_ids:
        strokes = journal.strokes(frame_id)
        before = labels.status(frame_id, bool(strokes) and labels.has_original(frame_id))
        truth = before == "truth" and not strokes
        states["truth" if truth else STATE_NAMES[state_of(strokes, before)]] += 1
        # Only this image is read, because the others take most of the time.
        pixels += np.bincount(labels.parts(frame_id).ravel(), minlength=256)
    return dict(states), {part.name: int(pixels[part.id]) for part in PARTS}


def _audit_text(found: "Audit") -> str:
    """Return tables: a row for each person, then for each person a row for each part; rejected last."""
    tables = [_people(found), *(_parts(person) for person in found.people if person.parts)]
    rejected = [f"rejected {frame_id}: {reason}" for frame_id, reason in found.rejected.items()]
    return "\n\n".join([*tables, *rejected])


def _people(found: "Audit") -> str:
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


def _parts(person: "PersonWork") -> str:
    rows = [
        (name, work.strokes, f"{work.seconds:.1f}", work.gained_px, work.lost_px)
        for name, work in person.parts.items()
    ]
    return table(("part", "strokes", "seconds", "px gained", "px lost"), rows, f"Parts, {person.who}")
