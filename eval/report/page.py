"""The report on results: its sections, and the tables beside it."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal

from annotate.parts import PAPER
from annotate.scheme.scheme import Part, Scheme
from eval.compare import paper_results as paper
from eval.compare.common_scheme import scheme_note
from eval.compare.results import Result
from eval.report import figures, numbers
from eval.report.estimates import in_shown_order, row_shares, shown_order
from eval.report.gather import Material
from eval.report.html_page import Head, Section, html_of
from sensors.files.atomic import check_free, check_suffix, write_bytes

CHARTED: Mapping[Literal["recall", "iou"], str] = {"recall": "Recall", "iou": "IoU"}
"""Scores by part with a chart."""


def write_report(path: Path, material: Material, overwrite: bool = False) -> list[Path]:
    """Write the page, with its numbers as .csv, .json and .tex; return all files, the page last.

    Raises ExistsError before writing if one exists and ``overwrite`` is not set.
    """
    outputs = free_outputs(path, overwrite)
    contents = [*numbers.texts(material).values(), render(material)]
    path.parent.mkdir(parents=True, exist_ok=True)
    for file, text in zip(outputs, contents, strict=True):
        # Half a surrogate pair in a name becomes a question mark.
        write_bytes(file, text.encode(errors="replace"))
    return outputs


def free_outputs(path: Path, overwrite: bool) -> list[Path]:
    """Return the paths of the page's files, the page last.

    Raises ExistsError if one exists and ``overwrite`` is not set, CloudError for another suffix than .html.
    """
    check_suffix(path, ".html", "")
    outputs = [*(path.with_suffix(suffix) for suffix in numbers.SUFFIXES), path]
    for file in outputs:
        check_free(file, overwrite)
    return outputs


def render(material: Material) -> str:
    """Return the page as HTML; the same material gives the same bytes."""
    results, citation = material.results, paper.CITATION if paper.published(material.schemes) else ""
    measured = (
        f"{r.title} on {len(r.comparison.frame_ids)} frames of {r.comparison.n_subjects} people. "
        for r in results
    )
    schemes = " and ".join(scheme.name for scheme in material.schemes)
    beside = f", beside the results of {citation}" if citation else ""
    lead = f"{''.join(measured)}Scores are per pixel, over the parts of scheme {schemes}{beside}."
    footer = "The same numbers stand beside it as CSV, JSON and LaTeX."
    return html_of(Head("Body-part labels: comparison report", lead, footer), sections(material))


def sections(material: Material) -> Iterator[Section]:
    """Yield the page's sections, in order; sections without content are left out."""
    results, ceiling = material.results, material.ceiling
    several = len(material.schemes) > 1
    notes = [f"{r.title}: {r.comparison.ci_note}." for r in results if r.comparison.ci_note]
    if several:
        notes.append("The results have different schemes; only the section Differences compares their means.")
    yield Section(
        "Headline",
        "Mean recall is the share of a part's pixels with the right label, averaged over the parts. "
        "Intervals are 95 %, over people. Lower is better for swaps and calibration error.",
        notes=notes,
        figures={"Mean recall with its 95 % interval": figures.overview(results, ceiling)},
        tables=[("Scores", numbers.summary_table(material))],
    )
    yield Section(
        "Kinds of frames",
        "Mean recall by kind of frame, with the 95 % interval and the number of frames.",
        tables=list(numbers.group_tables(results)),
    )
    of_paper = ", diamonds the paper's recall" if paper.published(material.schemes) else ""
    yield Section(
        "Parts",
        f"Points are scores of the whole set, bars 95 % intervals{of_paper}.",
        figures={
            f"{title} by part{f', scheme {scheme.name}' if several else ''}": figures.by_part(
                results, scheme, name, ceiling
            )
            for scheme in material.schemes
            for name, title in CHARTED.items()
        },
        tables=[(result.title, numbers.part_table(result)) for result in results],
    )
    yield from _difference_sections(material)
    shares = {r.title: (row_shares(r.comparison), shown_order(r.comparison.scheme)) for r in results}
    papers = {
        one.title: (in_shown_order(one.table, PAPER), shown_order(PAPER))
        for one in paper.published(material.schemes)
    }
    yield Section(
        "Confusion",
        "Each row is a true part and adds up to 1; values below 0.005 are left blank.",
        figures={title: figures.confusion_matrix(*one) for title, one in (shares | papers).items()},
    )
    yield Section(
        "Errors",
        "Labels are least certain at borders; errors deep inside a part are graver.",
        figures={
            "Kinds of error": figures.error_kinds(results),
            "Error rate by distance to a border": figures.error_distance(results),
            "Boundary F by tolerance": figures.boundary(results),
        },
        tables=[("Sides and outlines", numbers.error_table(results))],
    )
    yield from _person_sections(material)
    yield from _last_sections(material)


def _difference_sections(material: Material) -> Iterator[Section]:
    found = material.differences
    if not found:
        return
    charts = {}
    for scheme in dict.fromkeys(one.scheme for one in found):
        of_scheme = f", scheme {scheme.name}" if len(material.schemes) > 1 else ""
        charts[f"Difference of recall by part{of_scheme}"] = figures.differences(found, scheme)
    yield Section(
        "Differences",
        "Differences with 95 % intervals, paired on the same frames. An interval across 0 shows no "
        "difference. Wilcoxon's test needs six people and frames in common.",
        notes=[f"{d.a} minus {d.b}: {d.note}" for d in found if d.note],
        figures=charts,
        tables=[("All scores", numbers.difference_table(found))],
    )


def _legends(schemes: Iterable[Scheme]) -> dict[str, Sequence[Part]]:
    """Return the parts of each scheme by a heading, which one scheme does not need."""
    different = list(dict.fromkeys(schemes))
    return {f"{scheme.name}:" if len(different) > 1 else "": scheme.parts for scheme in different}


def _person_sections(material: Material) -> Iterator[Section]:
    results = material.results
    if any(result.comparison.has_confidence for result in results):
        yield Section(
            "Calibration",
            "Pixels binned by confidence. Below the dashed diagonal the labels are over-confident. Doubtful "
            "labels are parts of the truth to which the prediction gives the least probability.",
            figures={"Reliability inside parts and near borders": figures.reliability(results)},
            tables=[("Doubtful labels", numbers.suspect_table(results))],
        )
    if any(result.comparison.joints for result in results):
        yield Section(
            "Joints",
            "Joints of the network against true joints, without alignment. All rows but the fourth are of "
            "joints inside the image. A visible joint has a reading of its own part at its pixel. A joint "
            "that the network did not give has no error, and is within no distance.",
            figures={"Share of the joints by distance": figures.pck(results)},
            tables=[
                ("Error and share within a distance", numbers.joint_table(results)),
                *numbers.joint_group_tables(results),
            ],
        )
    yield Section(
        "People",
        "Every point is a frame; a box holds the middle half of a person's frames.",
        figures={"mIoU of every frame, by person": figures.people(results)},
        tables=[("Frames, worst first", numbers.frame_table(results))],
    )
    if any(material.galleries.values()):
        lead = "The worst, random and best frames by mIoU, cropped to the person."
        rows = [
            (f"{title} · {f.group} · {f.frame_id} · {f.subject} · mIoU {f.miou:.3f}", f.columns)
            for title, frames in material.galleries.items()
            for f in frames
        ]
        shown = [r.comparison.scheme for r in results if material.galleries.get(r.title)]
        yield Section("Gallery", lead, rows=rows, legends=_legends(shown))


def _last_sections(material: Material) -> Iterator[Section]:
    of_paper = bool(paper.published(material.schemes))
    seconds = f" The paper gives about {paper.SECONDS_PER_FRAME:.0f} s a frame." if of_paper else ""
    if material.scenes:
        clouds = {scene.title: figures.point_cloud(scene) for scene in material.scenes}
        yield Section("3D", "Drag to turn; the menu changes the colours.", figures=clouds)
    for shown in material.shown:
        rows = [(f"{frame.frame_id} {frame.subject}", frame.columns) for frame in shown.frames]
        legends = _legends([shown.scheme])
        yield Section(f"Without a truth: {shown.title}", shown.note, rows=rows, legends=legends)
    if material.trainings:
        curves = {
            "Training loss": figures.loss(material.trainings),
            "Scores on held-out frames": figures.learning(material.trainings),
        }
        yield Section("Trainings", "The loss over the images seen, and the scores by epoch.", figures=curves)
    for one in material.trainings:
        held_out = [("One held-out frame", one.pictures)] if one.pictures else []
        lead = "Plan, and one held-out frame."
        legends = _legends([one.scheme])
        yield Section(f"Training: {one.title}", lead, rows=held_out, legends=legends, facts=one.facts)
    if any(audit.people for audit in material.audits.values()):
        rejected = [(t, frame, why) for t, a in material.audits.items() for frame, why in a.rejected.items()]
        yield Section(
            "Corrections",
            "From the journal of each label set. Active seconds leave out pauses. Untouched: accepted frames "
            f"without a change.{seconds}",
            notes=[f"Rejected in {title}: {frame} ({why})" for title, frame, why in rejected],
            figures={"Active seconds of frames, mean of five": figures.effort(material.audits)},
            tables=[("Work", numbers.audit_table(material.audits))],
        )
    yield Section(
        "Method and sources",
        "Undefined pixels of the truth are ignored; undefined pixels of the prediction count as background. "
        "A part that no frame shows is left out of every mean. Corrections that start from a model's labels "
        "favour that model." + (" The paper's frames, people and cameras differ from these." * of_paper),
        facts=dict(material.facts) | _facts(material.results),
    )


def _facts(results: Sequence[Result]) -> dict[str, str]:
    """Return the facts of each result, with the shares of undefined pixels."""
    facts = {}
    for result in results:
        shares = result.comparison.undefined_shares
        facts[f"{result.title}: undefined"] = (
            f"truth {shares['truth']:.1%}, prediction {shares['predicted']:.1%}; "
            f"{result.comparison.extra_frames} predicted frames without a truth"
        )
        if not paper.published([result.comparison.scheme]):
            facts[f"{result.title}: scheme"] = scheme_note(result.comparison.scheme)
        facts |= {f"{result.title}: {name}": fact for name, fact in result.facts.items()}
    return facts
