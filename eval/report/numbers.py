"""Tables of the report as data frames of text, and the files of numbers beside the page."""

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd

from annotate.correction.audit import Audit
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from eval.compare import paper_results as paper
from eval.compare.details import suspicious
from eval.compare.difference import Difference
from eval.compare.results import Result
from eval.report.estimates import (
    JOINT_SCORES,
    SUMMARY,
    SWAPS,
    estimate,
    group_recall,
    joint_estimate,
    printed,
    row_shares,
    shown_order,
    summary_of,
)
from eval.report.gather import Material
from eval.scores.joint_scores import GROUPS
from eval.scores.joint_scores import INSIDE as IN_IMAGE
from eval.scores.traits import groups, writable

SUFFIXES = (".csv", ".json", ".tex")
PART_SCORES = {"recall": "Recall", "precision": "Precision", "iou": "IoU", "dice": "Dice",
               "boundary_iou_by_part": "Boundary IoU"}  # fmt: skip
INSIDE = {
    "miou_merged": "mIoU with left and right merged",
    "mean_recall_person": "Mean recall where both maps have a person",
    "miou_person": "mIoU where both maps have a person",
    "mean_recall_all": "Mean recall with the background as one more part",
    "error_rate_near": "Error rate within 3 px of a border",
    "error_rate_inside": "Error rate farther inside",
}
KIND_TITLES = {
    "subject": "Person",
    "activity": "Pose",
    "posture": "Posture",
    "facing": "Facing",
    "sensor": "Sensor",
    "view": "Seen from",
    "distance": "Distance",
    "invalid depth": "Share of invalid depth",
    "status": "Labels",
    "hard": "Difficulty",
}
JOINT_KINDS = ("posture", "facing", "sensor")
ROWS, SUSPECTS = 200, 30  # frames and suspicious labels listed
VALUES = 24  # most frequent values of a trait listed


def _table(data: object, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """Return a data frame of writable text."""
    if isinstance(data, dict):
        data = {_text(name): values for name, values in data.items()}
    return pd.DataFrame(data, columns=columns, dtype=object).map(_text)


def _text(value: object) -> object:
    return writable(value) if isinstance(value, str) else value


def summary_table(material: Material) -> pd.DataFrame:
    """Return the summary scores of every result, of two people's agreement (the ceiling) and of the paper."""
    titled = [(result.title, result) for result in material.results]
    if material.ceiling is not None:
        titled.append((f"{material.ceiling.title} (two people)", material.ceiling))
    rows, schemes = [], [result.comparison.scheme for _, result in titled]
    for title, result in titled:
        c = result.comparison
        scores = {heading: printed(name, estimate(c, name)) for name, heading in summary_of(c.scheme).items()}
        size = {"Frames": f"{len(c.frame_ids):,}", "People": str(c.n_subjects)}
        rows.append({"Result": title, **_scheme(c.scheme, schemes), **scores, **size})
    for one in paper.published(material.schemes):
        size = {"Frames": f"{one.frames:,}", "People": str(one.people or "--")}
        head = {"Result": one.title, **_scheme(PAPER, schemes)}
        rows.append({**head, SUMMARY["mean_recall"]: f"{one.mean_recall:.3f}", **size})
    return _table(rows).fillna("--")


def _scheme(own: Scheme, schemes: Sequence[Scheme]) -> dict[str, str]:
    """Return a cell of the scheme's name; empty where ``schemes`` are one scheme, the row's own."""
    return {} if {own} == set(schemes) else {"Scheme": own.name}


def part_table(result: Result) -> pd.DataFrame:
    """Return every score of every part of a result, with the paper's recall in the paper's scheme."""
    c = result.comparison
    rows = []
    for part in c.scheme.parts:
        pixels = c.matrices[:, part.id].sum(-1)
        scores = {t: printed(name, estimate(c, name, part.id)) for name, t in PART_SCORES.items()}
        size = {"Pixels": f"{int(pixels.sum()):,}", "Frames": f"{int((pixels > 0).sum()):,}"}
        rows.append({"Part": part.title, **size, **scores})
        if paper.published([c.scheme]):
            rows[-1]["Paper's recall, real"] = f"{paper.REAL.table[part.id, part.id]:.2f}"
    return _table(rows)


def difference_table(found: Sequence[Difference]) -> pd.DataFrame:
    """Return a row for each difference: all summary scores, Wilcoxon's p, and the number of frames."""
    rows, schemes = [], [one.scheme for one in found]
    for one in found:
        names = {name: title for name, title in summary_of(one.scheme).items() if name != "ece"}
        p = one.wilcoxon_p.get("mean_recall")
        scores = {title: printed(name, estimate(one, name), sign="+") for name, title in names.items()}
        frames = f"{one.frames[0]:,}, the same" if one.paired else f"{one.frames[0]:,} and {one.frames[1]:,}"
        size = {"Wilcoxon p": "--" if p is None else f"{p:.3f}", "Frames": frames}
        head = {"Difference": f"{one.a} minus {one.b}", **_scheme(one.scheme, schemes)}
        rows.append({**head, **scores, **size})
    return _table(rows).fillna("--")


def group_tables(results: Sequence[Result]) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield title and table of mean recall by each trait that differs between frames or results."""
    by_result = [groups(r.comparison.subjects, r.comparison.traits) for r in results]
    for kind, title in KIND_TITLES.items():
        counts = Counter[str]()
        for found in by_result:
            counts.update({value: len(frames) for value, frames in found.get(kind, {}).items()})
        if len(counts) < 2:
            continue
        values = sorted((value for value, _ in counts.most_common(VALUES)), key=_place)
        columns = {title: values}
        for result, found in zip(results, by_result, strict=True):
            of = found.get(kind, {})
            columns[result.title] = [
                f"{printed('recall', group_recall(result.comparison, of[v]))} of {len(of[v]):,}"
                if v in of
                else "--"
                for v in values
            ]
        left_out = len(counts) - len(values)
        yield title + (f" ({left_out} rarer values left out)" if left_out else ""), _table(columns)


def _place(value: str) -> tuple[bool, float]:
    """Return a sort key: ranges ("under 1 m", "1 to 1.5 m") by lower end; others keep their order."""
    start = re.match(r"(under )?([0-9.]+) ?(to|m|%)", value)
    return (False, float(start[2]) - bool(start[1]) * 1e-3) if start else (True, 0.0)


def error_table(results: Sequence[Result]) -> pd.DataFrame:
    """Return the kinds of errors with their extent, one column per result."""
    columns = {}
    for result in results:
        c = result.comparison
        kinds = {name: int(n) for name, n in c.error_kinds.items()}
        wrong = sum(kinds.values())
        sides = {
            SUMMARY[SWAPS]: printed(SWAPS, estimate(c, SWAPS)),
            "Swaps among all errors": f"{kinds['left_right_swap'] / max(wrong, 1):.1%}",
            "Frames that a left-right flip improves": str(c.flipped_frames),
        }
        columns[result.title] = {
            "All wrong pixels": f"{wrong / max(c.confusion.sum(), 1):.1%}",
            **(sides if c.scheme.twins else {}),
            **{title: printed(name, estimate(c, name)) for name, title in INSIDE.items()},
        }
    return _table(columns).fillna("--").reset_index(names="Error")


def suspect_table(results: Sequence[Result]) -> pd.DataFrame:
    """Return the least probable labels of the truth, the worst first."""
    found = [(r.title, one) for r in results for one in suspicious(r.comparison, SUSPECTS)]
    rows = [
        (title, s.frame_id, s.part.title, f"{s.quality:.3f}", f"{s.pixels:,}")
        for title, s in sorted(found, key=lambda pair: pair[1].quality)[:SUSPECTS]
    ]
    return _table(rows, columns=["Result", "Frame", "Part", "Quality", "Pixels"])


def joint_table(results: Sequence[Result]) -> pd.DataFrame:
    """Return error and shares within distances of the network's joints, by visibility and by joint."""
    rows = {group.replace("_", " "): group for group in GROUPS}
    columns = {"Joints": list(rows)}
    for result in results:
        if joints := result.comparison.joints:
            for name, title in JOINT_SCORES.items():
                scores = [printed(name, joint_estimate(joints.estimates, name, group)) for group in GROUPS]
                columns[f"{result.title}: {title}"] = scores
    return _table(columns)


def joint_group_tables(results: Sequence[Result]) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield title and table of the scores of joints inside the image, by each trait of ``JOINT_KINDS``."""
    for kind in JOINT_KINDS:
        rows = []
        for result in results:
            c = result.comparison
            if c.joints is None:
                continue
            for value, frames in groups(c.subjects, c.traits).get(kind, {}).items():
                of = c.only(frames).joints
                assert of is not None
                scores = {
                    title: printed(name, joint_estimate(of.estimates, name, IN_IMAGE))
                    for name, title in JOINT_SCORES.items()
                }
                rows.append(
                    {KIND_TITLES[kind]: value, "Result": result.title, "Frames": len(frames), **scores}
                )
        if rows:
            yield f"Joints by {KIND_TITLES[kind].lower()}", _table(rows)


def frame_table(results: Sequence[Result]) -> pd.DataFrame:
    """Return the frames of lowest mIoU of every result."""
    rows = []
    for result in results:
        c = result.comparison
        for i in np.argsort(c.frame_miou, kind="stable")[:ROWS]:
            hard = ", ".join(c.traits[i].hard)
            rows.append((result.title, c.frame_ids[i], c.subjects[i], hard, f"{c.frame_miou[i]:.3f}"))
    return _table(rows, columns=["Result", "Frame", "Person", "Difficulty", "mIoU"])


def audit_table(audits: Mapping[str, Audit]) -> pd.DataFrame:
    """Return the work of each person on each corrected label set."""
    rows = [
        {
            "Labels": title, "Person": p.who, "When": " to ".join(sorted({p.first[:10], p.last[:10]})),
            "Frames": p.frames, "Seconds, median": f"{p.seconds_median:.1f}",
            "90th percentile": f"{p.seconds_p90:.1f}", "Strokes": p.strokes, "Undos": p.undos,
            "Changed": f"{p.changed:.1%}", "Accepted": p.accepted, "Untouched": f"{p.accepted_untouched:.1%}",
        }
        for title, found in audits.items()
        for p in found.people
    ]  # fmt: skip
    return _table(rows)


def texts(material: Material) -> dict[str, str]:
    """Return the contents of the files beside the page, by suffix."""
    return {".csv": to_csv(material.results), ".json": to_json(material), ".tex": to_latex(material)}


def to_csv(results: Sequence[Result]) -> str:
    """Return a CSV text with a score and its interval per line; a missing interval is empty.

    The paper's recalls come last.
    """
    rows: list[tuple[object, ...]] = []
    for result in results:
        c = result.comparison
        # No spreadsheet may read a title as a formula.
        title = f"'{result.title}" if result.title[:1] in ("=", "+", "-", "@", "\t", "\r") else result.title
        scores = [(name, "", estimate(c, name)) for name in (*summary_of(c.scheme), *INSIDE)]
        scores += [(name, p.name, estimate(c, name, p.id)) for p in c.scheme.parts for name in PART_SCORES]
        size = (len(c.frame_ids), c.n_subjects)
        rows += [(title, name, part, e.value, e.low, e.high, *size) for name, part, e in scores]
    for one in paper.published(result.comparison.scheme for result in results):
        of = (np.nan, np.nan, one.frames, one.people)
        rows.append((one.title, "mean_recall", "", one.mean_recall, *of))
        rows += [(one.title, "recall", p.name, one.table[p.id, p.id], *of) for p in PAPER.parts]
    columns = ["result", "score", "part", "value", "low95", "high95", "frames", "people"]
    kinds = dict.fromkeys(("value", "low95", "high95"), "float64") | {"people": "Int64"}
    frame = _table(rows, columns=columns).astype(kinds)
    return str(frame.to_csv(index=False, float_format="%.6f", lineterminator="\n"))


def to_json(material: Material) -> str:
    """Return the results as `evaluate` and `compare` print them, the audits and the facts."""
    value = {
        "facts": dict(material.facts),
        "results": [
            {"title": r.title, "facts": dict(r.facts), **r.comparison.to_evaluation_json()}
            for r in material.results
        ],
        "ceiling": material.ceiling.comparison.to_evaluation_json() if material.ceiling else None,
        "differences": [found.to_json() for found in material.differences],
        "audits": {title: audit.to_json() for title, audit in material.audits.items()},
    }
    if paper.published(material.schemes):
        value["paper"] = {
            "citation": paper.CITATION,
            "parts": [part.name for part in paper.PARTS],
            "synthetic": paper.SYNTHETIC.table.tolist(),
            "real": paper.REAL.table.tolist(),
        }
    return json.dumps(value, allow_nan=False, indent=1) + "\n"


def to_latex(material: Material) -> str:
    r"""Return tables for \input: summary, parts and confusion matrix of each result."""
    tables = [summary_table(material), *map(part_table, material.results)]
    for result in material.results:
        names = [part.title for part in shown_order(result.comparison.scheme)]
        rows = _table(row_shares(result.comparison), columns=names)
        rows = rows.map(lambda v: "--" if np.isnan(v) else f"{v:.2f}")
        rows.insert(0, writable(result.title), names)
        tables.append(rows)
    printable = (table.rename(columns=_printable).map(_printable) for table in tables)
    shown = [table.style.hide(axis="index").to_latex(hrules=True, convert_css=False) for table in printable]
    return "% Needs \\usepackage{booktabs}.\n\n" + "\n".join(shown)


_TEX = {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    **{letter: "\\" + letter for letter in "&%$#_{}"},
}  # fmt: skip


def _printable(text: object) -> str:
    """Return text with LaTeX's own characters escaped and control characters dropped."""
    return "".join(_TEX.get(letter, letter) for letter in str(text) if letter.isprintable())
