"""Write the report: one HTML file that opens offline, on a screen or on paper, and tables beside it."""

import base64
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

import pandas as pd
import plotly.graph_objects as go
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from annotate.parts import BODY_PARTS
from eval.compare import paper_results as paper
from eval.compare.results import Result
from eval.report import numbers
from eval.report.estimates import estimate, verdict
from eval.report.figures import figures_of
from eval.report.frame_images import ERROR_KINDS, Image, data_uri
from eval.report.gallery import GalleryFrame
from eval.report.gather import Material
from sensors.errors import CloudError
from sensors.files.atomic import check_free, write_bytes

PLOTLY = files("plotly").joinpath("package_data", "plotly.min.js")
_PAGES = Environment(
    loader=PackageLoader("eval.report"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_PAGES.filters["picture"] = data_uri


@dataclass(frozen=True)
class Section:
    """Section of the page. Its blocks are shown in this order; all their text is escaped."""

    id: str
    title: str
    lead: str
    notes: Sequence[str] = ()
    figures: Mapping[str, str] = field(default_factory=dict)
    tables: Sequence[tuple[str, pd.DataFrame]] = ()
    rows: Sequence[tuple[str, Mapping[str, Image]]] = ()
    facts: Mapping[str, str] = field(default_factory=dict)


def write_report(path: Path, material: Material, overwrite: bool = False) -> list[Path]:
    """Write the page, and its numbers as .csv, .json and .tex beside it; return all files, the page last.

    Raises ExistsError when one of them is there and ``overwrite`` is not set: then none is written.
    """
    outputs = free_outputs(path, overwrite)
    contents = [*numbers.texts(material).values(), render(material)]
    path.parent.mkdir(parents=True, exist_ok=True)
    for file, text in zip(outputs, contents, strict=True):
        # Names, subjects and notes may hold half a surrogate pair, which no file of text can.
        write_bytes(file, text.encode(errors="replace"))
    return outputs


def free_outputs(path: Path, overwrite: bool) -> list[Path]:
    """Return the output files of a page's path, the page last; call this before long work.

    Raises ExistsError when one exists and ``overwrite`` is not set, CloudError for a table's suffix.
    """
    if path.suffix in numbers.SUFFIXES:
        raise CloudError(f"{path} has the suffix of a table; give a name that ends in .html")
    outputs = [*(path.with_suffix(suffix) for suffix in numbers.SUFFIXES), path]
    for file in outputs:
        check_free(file, overwrite)
    return outputs


def render(material: Material) -> str:
    """Return the page; the same material gives the same bytes."""
    figures = figures_of(material)
    script = _PAGES.loader.get_source(_PAGES, "page.js")[0]  # type: ignore[union-attr]
    plotly = PLOTLY.read_text()
    return _PAGES.get_template("page.html.j2").render(
        version=version("annotate-cloud"),
        policy=policy(plotly, script),
        results=material.results,
        citation=paper.CITATION,
        sections=[_with_figures(section, figures) for section in sections(material)],
        figures=figures,
        parts=BODY_PARTS,
        errors=[kind for name, kind in ERROR_KINDS.items() if name != "background"],
        data=Markup(embedded(figures)),
        plotly=Markup(plotly),
        script=Markup(script),
    )


def _with_figures(section: Section, figures: Mapping[str, go.Figure]) -> Section:
    shown = {name: label for name, label in section.figures.items() if name in figures}
    return Section(**{**vars(section), "figures": shown})


def policy(*scripts: str) -> str:
    """Return the page's Content-Security-Policy: only these scripts, embedded pictures, no network
    request.
    """
    hashes = (base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts)
    allowed = " ".join(f"'sha256-{value}'" for value in hashes)
    # Plotly makes a style sheet of its own and draws its pictures from blobs of the page.
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def embedded(figures: Mapping[str, go.Figure]) -> str:
    """Return the figures as JSON for a script element; no text of it is markup."""
    text = "{" + ",".join(f'"{name}":{figure.to_json()}' for name, figure in figures.items()) + "}"
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def sections(material: Material) -> Iterator[Section]:
    """Yield the sections that the material fills, in the order of the page."""
    results, found = material.results, material.differences
    yield Section(
        "headline",
        "Headline",
        "Mean recall is the share of a part's pixels with the right label, averaged over the eleven parts. "
        "Intervals are 95 %, over people. Lower is better for swaps and calibration error.",
        notes=[f"{r.title}: {_standing(r)}" for r in results],
        figures={"overview": "Mean recall of every result with its 95 % interval, and the paper's"},
        tables=[("Scores", numbers.summary_table(material))],
    )
    gaps = [("Recall by part", numbers.gap_table(found))] if found else []
    yield Section(
        "gap",
        "Kinds of frames",
        "Mean recall by kind of frame, with the 95 % interval and the number of frames.",
        tables=[*gaps, *numbers.group_tables(results)],
    )
    yield Section(
        "parts",
        "Parts",
        "Points are scores of the whole set, bars 95 % intervals, diamonds the paper's recall.",
        figures={"parts-recall": "Recall by part", "parts-iou": "IoU by part"},
        tables=[(result.title, numbers.part_table(result)) for result in results],
    )
    if found:
        yield Section(
            "differences",
            "Differences",
            "Differences with 95 % intervals, paired on the same frames. An interval across 0 shows no "
            "difference. Wilcoxon's test needs six people and frames in common.",
            notes=[f"{d.a} minus {d.b}: {d.note}" for d in found if d.note],
            figures={"differences": "Difference of recall by part"},
            tables=[("All scores", numbers.difference_table(found))],
        )
    matrices = {f"confusion-{i}": result.title for i, result in enumerate(results)}
    yield Section(
        "confusion",
        "Confusion",
        "Each row is a true part and adds up to 1; values below 0.005 are left blank.",
        figures=matrices | {"paper-0": "Paper, Table 2: synthetic", "paper-1": "Paper, Table 3: real"},
    )
    yield Section(
        "errors",
        "Errors",
        "Labels are least certain at borders; errors deep inside a part are graver.",
        figures={
            "error-kinds": "Kinds of error",
            "error-distance": "Error rate by distance to a border",
            "boundary": "Boundary F by tolerance",
        },
        tables=[("Sides and outlines", numbers.error_table(results))],
    )
    if any(result.comparison.has_confidence for result in results):
        yield Section(
            "calibration",
            "Calibration",
            "Pixels binned by confidence. Below the dashed diagonal the labels are over-confident. Doubtful "
            "labels are parts of the truth to which the prediction gives the least probability.",
            figures={"reliability": "Reliability inside parts and near borders"},
            tables=[
                ("Expected calibration error", numbers.calibration_table(results)),
                ("Doubtful labels", numbers.suspect_table(results)),
            ],
        )
    yield from _last_sections(material)


def _last_sections(material: Material) -> Iterator[Section]:
    results = material.results
    if any(result.comparison.joints_mm is not None for result in results):
        yield Section(
            "joints",
            "Joints",
            "Joints of the network against true joints: mean error without alignment, and the share within "
            "100 mm, of joints inside the image, hidden ones too.",
            figures={"pck": "Share of the joints by distance"},
            tables=[("Error and share within 100 mm", numbers.joint_table(results))],
        )
    yield Section(
        "people",
        "People",
        "Every point is a frame; a box holds the middle half of a person's frames.",
        figures={"people": "mIoU of every frame, by person"},
        tables=[
            ("Means of mIoU", numbers.mean_table(results)),
            ("Frames, worst first", numbers.frame_table(results)),
        ],
    )
    galleries = [(title, frame) for title, frames in material.galleries.items() for frame in frames]
    if galleries:
        lead = "The worst, random and best frames by mIoU, cropped to the person."
        rows = [(_caption(title, frame), frame.columns) for title, frame in galleries]
        yield Section("gallery", "Gallery", lead, rows=rows)
    if material.scenes:
        labels = {f"scene-{i}": scene.title for i, scene in enumerate(material.scenes)}
        yield Section("scenes", "3D", "Drag to turn; the menu changes the colours.", figures=labels)
    for i, shown in enumerate(material.shown):
        rows = [(f"{frame.frame_id} {frame.subject}", frame.columns) for frame in shown.frames]
        yield Section(f"shown-{i}", f"Without a truth: {shown.title}", shown.note, rows=rows)
    for i, one in enumerate(material.trainings):
        own = {} if i else {"loss": "Training loss", "learning": "Scores on held-out frames"}
        pictures = [("One held-out frame", one.pictures)] if one.pictures else []
        lead = "The loss over the images seen, and one held-out frame during the training."
        title = f"Training: {one.title}"
        yield Section(f"training-{i}", title, lead, figures=own, rows=pictures, facts=one.facts)
    if any(audit.people for audit in material.audits.values()):
        rejected = [(t, frame, why) for t, a in material.audits.items() for frame, why in a.rejected.items()]
        yield Section(
            "audit",
            "Corrections",
            "From the journal of each label set. Active seconds leave out pauses. Untouched: accepted frames "
            f"without a change. The paper gives about {paper.SECONDS_PER_FRAME:.0f} s a frame.",
            notes=[f"Rejected in {title}: {frame} ({why})" for title, frame, why in rejected],
            figures={"effort": "Active seconds of frames in the order of work, mean of five"},
            tables=[("Work", numbers.audit_table(material))],
        )
    yield Section(
        "method",
        "Method and sources",
        "Undefined pixels of the truth are ignored; undefined pixels of the prediction count as background. "
        "A part that no frame shows is left out of every mean. Corrections that start from a model's labels "
        "favour that model. The paper's frames, people and cameras differ from these.",
        facts=dict(material.facts) | _facts(material),
    )


def _standing(result: Result) -> str:
    c = result.comparison
    note = f"; {c.ci_note}" if c.ci_note else ""
    return f"{verdict(estimate(c, 'mean_recall'))}{note}."


def _caption(title: str, frame: GalleryFrame) -> str:
    return f"{title} · {frame.group} · {frame.frame_id} · {frame.subject} · mIoU {frame.miou:.3f}"


def _facts(material: Material) -> dict[str, str]:
    """Return what each result was measured on, with the shares of undefined pixels."""
    facts = {}
    for result in material.results:
        shares = result.comparison.undefined_shares
        facts[f"{result.title}: undefined"] = (
            f"truth {shares['truth']:.1%}, prediction {shares['predicted']:.1%}; "
            f"{result.comparison.extra_frames} predicted frames without a truth"
        )
        facts |= {f"{result.title}: {name}": fact for name, fact in result.facts.items()}
    return facts
