"""Scores as text tables, with intervals and the names of the best and the worst part."""

import math
from collections.abc import Mapping

from annotate.parts import BODY_PARTS
from cli.console import table
from eval.compare.compare import Comparison
from eval.compare.paired import Difference
from eval.report.estimates import SUMMARY, Estimate, difference_of, estimate, printed
from eval.scores.joint_errors import summary

TITLES = SUMMARY | {"recall": "Recall", "iou": "IoU"}
OF_PARTS = ("recall", "iou")


def scores_text(comparison: Comparison, *, intervals: bool) -> str:
    """Return tables of a comparison's scores: of the whole set, of the joints if known, and by part.

    intervals: add 95 % intervals in brackets, which takes some seconds.
    """

    def of(name: str, *index: int) -> Estimate:
        if intervals:
            return estimate(comparison, name, *index)
        return Estimate(float(comparison.scores[name][index]), math.nan, math.nan)

    whole = [(title, printed(name, of(name))) for name, title in SUMMARY.items() if of(name).known]
    if comparison.joints_mm is not None:
        joints = summary(comparison.joints_mm)
        scored = {"Joint error": ("mpjpe_mm", 1, "mm"), "Joints within 100 mm": ("pck_100mm", 100, "%")}
        for title, (name, scale, unit) in scored.items():
            whole.append((title, "-" if joints[name] is None else f"{joints[name] * scale:.1f} {unit}"))
    parts = [
        (part.title, *(printed(name, of(name, part.id)) for name in OF_PARTS), int(pixels))
        for part, pixels in zip(BODY_PARTS, comparison.confusion.sum(1)[1:], strict=True)
    ]
    recall = {part.title: of("recall", part.id) for part in BODY_PARTS}
    heading = f"{len(comparison.frame_ids)} frames of {comparison.n_subjects} people"
    bracket = " [95 % interval]" if intervals else ""
    return "\n\n".join(
        [
            table(("score", f"value{bracket}"), whole, heading),
            table(("part", *(f"{TITLES[n]}{bracket}" for n in OF_PARTS), "pixels"), parts),
            _extremes(recall, "best", "worst"),
        ]
    )


def difference_text(found: Difference) -> str:
    """Return tables of A minus B: of the whole sets with Wilcoxon's p if known, and by part."""
    p = {name: "-" if value is None else f"{value:.3f}" for name, value in found.wilcoxon_p.items()}
    whole = [
        (title, printed(name, one, sign="+"), p.get(name, "-"))
        for name, title in SUMMARY.items()
        if (one := difference_of(found, name)).known
    ]
    parts = [
        (part.title, *(printed(name, difference_of(found, name, part.id), sign="+") for name in OF_PARTS))
        for part in BODY_PARTS
    ]
    frames = "the same frames" if found.paired else "different frames"
    heading = ("score", "difference [95 % interval]", "Wilcoxon p")
    recall = {part.title: difference_of(found, "recall", part.id) for part in BODY_PARTS}
    return "\n\n".join(
        [
            table(heading, whole, f"{found.a} minus {found.b}, on {frames}"),
            table(("part", *(f"{TITLES[name]} [95 % interval]" for name in OF_PARTS)), parts),
            _extremes(recall, "most gained", "least", sign="+"),
        ]
    )


def _extremes(recall: Mapping[str, Estimate], best: str, worst: str, sign: str = "") -> str:
    """Return a line with the parts of the highest and the lowest recall; "" where no part is known."""
    known = {title: one.value for title, one in recall.items() if one.known}
    if not known:
        return "No body part in the truth."
    ends = ((best, max(known, key=known.__getitem__)), (worst, min(known, key=known.__getitem__)))
    named = (f"{word} {title} ({known[title]:{sign}.3f})" for word, title in ends)
    return f"Recall by part: {', '.join(named)}"
