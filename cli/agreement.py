"""Label sets of the same frames, compared each with each: for compare, report and try."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from typer import BadParameter

from cli.console import Block, progress, provenance, table
from sensors.errors import CloudError

if TYPE_CHECKING:
    from annotate.labelset.labelled_frames import LabelledFrames
    from eval.report.agreement import Agreement


def are_label_sets(paths: Sequence[Path]) -> bool:
    """Return whether paths are label sets or datasets, False for results.

    Raises BadParameter for both together.
    """
    from annotate.labelset.labelled_frames import holds_frames

    held = {holds_frames(path) for path in paths}
    if held == {True, False}:
        raise BadParameter(
            "results and label sets cannot be compared; give results alone or label sets alone"
        )
    return held == {True}


def open_sets(paths: Sequence[Path]) -> "dict[str, LabelledFrames]":
    """Open label sets by name. Raises CloudError for two of one name."""
    from annotate.labelset.labelled_frames import open_frames

    sets: dict[str, LabelledFrames] = {}
    for path in paths:
        name = path.resolve().name
        if name in sets:
            raise CloudError(f"two label sets have the name {name!r}; rename the folder of one")
        sets[name] = open_frames(path)
    return sets


def compared(sets: "dict[str, LabelledFrames]") -> "list[Agreement]":
    """Compare each pair of label sets, with progress."""
    from eval.report.agreement import agreements, work_of

    with progress("compare", work_of(sets)) as advance:
        return agreements(sets, advance)


def agreement_text(found: "Sequence[Agreement]") -> Block:
    """Return a table with a column of scores for each pair of label sets."""
    from eval.report.estimates import agreement_row

    rows = [agreement_row(one) for one in found]
    lines = [(title, *(row[title] for row in rows)) for title in rows[0]]
    bracket = " [95 % interval]" if any(one.has_people for one in found) else ""
    heading = f"{len(found[-1].comparison.frame_ids)} frames{bracket}"
    return table(("score", *(one.result.title for one in found)), lines, heading)


def write_page(
    sets: "dict[str, LabelledFrames]",
    found: "Sequence[Agreement]",
    session: Path | None,
    out: Path,
    *notes: str,
) -> None:
    """Write the page on compared label sets. session: their recording, by default the one beside them."""
    from annotate.labelset.label_set import LabelSet
    from annotate.labelset.source_recording import Recorded, find_session
    from eval.report.agreement_page import Compared, write_agreement

    first = next((one for one in sets.values() if isinstance(one, LabelSet)), None)
    recording = session or (find_session(first) if first else None)
    recorded = Recorded(first, recording) if first and recording else None
    write_agreement(out, Compared(sets, found, recorded, notes, provenance()))
