"""Write the report: one HTML file that opens offline, light or dark, on a screen or on paper."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from numpy.typing import NDArray

from eval import paper
from eval.report import views
from eval.report.figures import ERROR_KINDS, data_uri
from eval.report.gallery import GalleryFrame
from eval.results import Result
from sensors.atomic import write_bytes
from sensors.errors import CloudError, ExistsError

TITLE = "Body-part labels: comparison report"

# Names, ids and subjects come from label files: everything is escaped, and the page's own content
# policy forbids scripts and requests altogether.
_PAGE = Environment(
    loader=FileSystemLoader(Path(__file__).parent / "templates"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_PAGE.filters["picture"] = data_uri


def write_report(
    path: Path,
    results: Sequence[Result],
    galleries: Mapping[str, Sequence[GalleryFrame]] | None = None,
    facts: Mapping[str, str] | None = None,
    effort_seconds: Sequence[float] = (),
    overwrite: bool = False,
) -> None:
    """Write one self-contained page about `results`, the most important one last.

    galleries: frames by the title of the result they belong to. facts: what was compared and how
    (command, seed, hashes), shown as given. effort_seconds: seconds of a person's work on each
    corrected frame. Raises CloudError without results, ExistsError when `path` is there and
    `overwrite` is not set.
    """
    if not results:
        raise CloudError("the report got 0 results; give at least one that evaluate wrote")
    if path.exists() and not overwrite:
        raise ExistsError(f"{path} exists already; choose another file or pass --overwrite")
    page = render(results, galleries or {}, facts or {}, effort_seconds)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, page.encode())


def render(
    results: Sequence[Result],
    galleries: Mapping[str, Sequence[GalleryFrame]],
    facts: Mapping[str, str],
    effort_seconds: Sequence[float] = (),
) -> str:
    """The page as a string; arguments as for `write_report`."""
    shown = [views.view_of(result) for result in results]
    return _PAGE.get_template("report.html.j2").render(
        title=TITLE,
        written=datetime.now(UTC).strftime("%d %B %Y, %H:%M UTC"),
        views=shown,
        ticks=views.axis_ticks(shown),
        parts=views.shown_parts(),
        paper=_paper_tables(),
        citation=paper.CITATION,
        frame_scores=_frame_scores(results),
        galleries={title: frames for title, frames in galleries.items() if frames},
        kinds=list(ERROR_KINDS.values()),
        facts=facts,
        effort=_effort(np.asarray(effort_seconds, np.float64)),
    )


def _paper_tables() -> dict[str, object]:
    """The paper's tables in the order they are shown, and what they sum up to."""
    return {
        "synthetic": views.shown(paper.TABLE2_SYNTHETIC),
        "real": views.shown(paper.TABLE3_REAL),
        "gap": views.shown(paper.TABLE3_REAL - paper.TABLE2_SYNTHETIC),
        "synthetic_recall": paper.mean_recall_of(paper.TABLE2_SYNTHETIC),
        "real_recall": paper.mean_recall_of(paper.TABLE3_REAL),
        "synthetic_frames": paper.SYNTHETIC_FRAMES,
        "real_frames": paper.REAL_FRAMES,
        "real_subjects": paper.REAL_SUBJECTS,
        "seconds": paper.SECONDS_PER_FRAME,
    }


def _frame_scores(results: Sequence[Result]) -> dict[tuple[str, str], float]:
    """mIoU by result title and frame id."""
    return {
        (result.title, frame_id): float(score)
        for result in results
        for frame_id, score in zip(result.comparison.frame_ids, result.comparison.frame_miou, strict=True)
    }


def _effort(seconds: NDArray[np.float64]) -> dict[str, float] | None:
    if not seconds.size:
        return None
    median, p90 = np.quantile(seconds, [0.5, 0.9])
    return {"frames": seconds.size, "median": float(median), "p90": float(p90), "total": float(seconds.sum())}
