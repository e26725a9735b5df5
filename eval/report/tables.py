"""The report's numbers for other programs: a long CSV, one JSON object, and tables for LaTeX."""

import csv
import io
import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from annotate.parts import BODY_PARTS, PARTS
from eval.compare import paper_results as paper
from eval.report.estimates import SHOWN_ORDER, SUMMARY, Estimate, printed, shown
from eval.report.gather import Material
from eval.report.views import ResultView

SUFFIXES = (".csv", ".json", ".tex")
"""Of the files beside the page, in the order of `texts`."""

OF_PAPER = (paper.SYNTHETIC, paper.REAL)

TEX_PERCENT = r"\,\%"

COLUMNS = ("result", "score", "part", "value", "low95", "high95", "frames", "people")

_TEX = {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    **{letter: "\\" + letter for letter in "&%$#_{}"},
}  # fmt: skip


def texts(material: Material) -> dict[str, str]:
    """The files beside the page by suffix."""
    views = material.views
    return dict(zip(SUFFIXES, (to_csv(views), to_json(material), to_latex(views)), strict=True))


def to_csv(views: Sequence[ResultView]) -> str:
    """CSV with one score per line and its interval, empty if there is none. The paper's recalls come last."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for view in views:
        comparison = view.result.comparison
        size = len(comparison.frame_ids), comparison.n_subjects
        for name, of_part, found in _scores(view):
            ends = (_cell(e) for e in (found.value, found.low, found.high))
            writer.writerow((_safe(view.result.title), name, of_part, *ends, *size))
    for one in OF_PAPER:
        of = one.frames, one.people
        writer.writerow((one.title, "mean_recall", "", _cell(one.mean_recall), "", "", *of))
        for part in BODY_PARTS:
            writer.writerow((one.title, "recall", part.name, one.table[part.id, part.id], "", "", *of))
    return out.getvalue()


def _scores(view: ResultView) -> Iterator[tuple[str, str, Estimate]]:
    for name, found in {**view.scores, **view.inside}.items():
        yield name, "", found
    for row in view.parts:
        for name, found in row.scores.items():
            yield name, row.part.name, found


def _cell(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.6f}"


def _safe(text: str) -> str:
    """Text that no spreadsheet takes for a formula."""
    return f"'{text}" if text[:1] in ("=", "+", "-", "@", "\t", "\r") else text


def to_json(material: Material) -> str:
    """The results as `evaluate` and `compare` print them, the audits and the facts."""
    value: dict[str, Any] = {
        "facts": dict(material.facts),
        "results": [
            {"title": r.title, "facts": dict(r.facts), **r.comparison.to_evaluation_json()}
            for r in material.results
        ],
        "ceiling": material.ceiling.comparison.to_evaluation_json() if material.ceiling else None,
        "differences": [found.to_json() for found in material.differences],
        "audits": {title: audit.to_json() for title, audit in material.audits.items()},
        "paper": {
            "citation": paper.CITATION,
            "parts": [part.name for part in PARTS],
            "synthetic": paper.SYNTHETIC.table.tolist(),
            "real": paper.REAL.table.tolist(),
        },
    }
    return json.dumps(value, allow_nan=False, indent=1) + "\n"


def to_latex(views: Sequence[ResultView]) -> str:
    r"""Tables for \input: summary, recall by part with the paper's, one confusion matrix a result."""
    blocks = [_summary_table(views), _part_table(views), *(_confusion_table(view) for view in views)]
    return "% Needs \\usepackage{booktabs}.\n\n" + "\n".join(blocks)


def _summary_table(views: Sequence[ResultView]) -> str:
    rows = [
        [tex(view.result.title), *(printed(name, view.scores[name], TEX_PERCENT) for name in SUMMARY),
         str(len(view.result.comparison.frame_ids)), str(view.result.comparison.n_subjects)]
        for view in views
    ]  # fmt: skip
    blank = ["--"] * (len(SUMMARY) - 1)
    for one in OF_PAPER:
        rows.append([one.title, f"{one.mean_recall:.3f}", *blank, str(one.frames), str(one.people or "--")])
    return _tabular(["Result", *(tex(title) for title in SUMMARY.values()), "Frames", "People"], rows)


def _part_table(views: Sequence[ResultView]) -> str:
    heading = ["Recall", *(tex(view.result.title) for view in views), *(one.title for one in OF_PAPER)]
    rows = [
        [row.part.title, *(printed("recall", view.parts[i].scores["recall"]) for view in views),
         *(f"{one.table[row.part.id, row.part.id]:.2f}" for one in OF_PAPER)]
        for i, row in enumerate(views[0].parts)
    ]  # fmt: skip
    return _tabular(heading, rows)


def _confusion_table(view: ResultView) -> str:
    parts = [PARTS[i].title for i in SHOWN_ORDER]
    rows = [
        [part, *("--" if np.isnan(v) else f"{v:.2f}" for v in row)]
        for part, row in zip(parts, shown(view.shares), strict=True)
    ]
    heading = [tex(view.result.title), *map(_short, parts)]
    return _tabular(heading, rows)


def _tabular(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [
        rf"\begin{{tabular}}{{l{'r' * (len(heading) - 1)}}}",
        r"\toprule",
        " & ".join(heading) + r" \\",
        r"\midrule",
        *(" & ".join(row) + r" \\" for row in rows),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def _short(title: str) -> str:
    sides = title.replace("Left ", "L ").replace("Right ", "R ").replace("Background", "BG")
    return sides.replace("upper ", "u.~").replace("lower ", "l.~")


def tex(text: str) -> str:
    """Text with LaTeX's own characters escaped and control characters dropped."""
    return "".join(_TEX.get(letter, letter) for letter in text if letter.isprintable())
