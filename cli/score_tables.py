"""Tables of scores for the terminal."""

import math
from collections.abc import Mapping

from cli.console import Block, block, table
from eval.compare.compare import Comparison
from eval.compare.difference import Difference
from eval.report.estimates import JOINT_SCORES, Estimate, estimate, joint_estimate, printed, summary_of
from eval.scores.joint_scores import GROUPS, SCORES, JointDifference, JointEstimates

OF_PARTS = {"recall": "Recall", "iou": "IoU"}


def scores_text(comparison: Comparison, *, intervals: bool) -> Block:
    """Return tables of a comparison's scores: of the whole set, by part, and of joints if any.

    intervals: with 95 % intervals in brackets, which take some seconds.
    """

    def of(name: str, *index: int) -> Estimate:
        if intervals:
            return estimate(comparison, name, *index)
        return Estimate(float(comparison.scores[name][index]), math.nan, math.nan)

    scheme, pixels = comparison.scheme, comparison.confusion.sum(1)
    whole = [(title, printed(name, of(name))) for name, title in summary_of(scheme).items() if of(name).known]
    parts = [
        (part.title, *(printed(name, of(name, part.id)) for name in OF_PARTS), int(pixels[part.id]))
        for part in scheme.parts
    ]
    recall = {part.title: of("recall", part.id) for part in scheme.parts}
    people = "1 person" if comparison.n_subjects == 1 else f"{comparison.n_subjects} people"
    heading = f"{len(comparison.frame_ids)} frames of {people}"
    bracket = " [95 % interval]" if intervals else ""
    tables = (
        table(("score", f"value{bracket}"), whole, heading),
        table(("part", *(f"{title}{bracket}" for title in OF_PARTS.values()), "pixels"), parts),
        *([joint_text(comparison.joints.estimates)] if comparison.joints else []),
        _extremes(recall, "best", "worst"),
    )
    return block(*tables)


def difference_text(found: Difference) -> Block:
    """Return tables of A minus B: of the whole sets with Wilcoxon's p, by part, and of joints if any."""
    p = {name: "-" if value is None else f"{value:.3f}" for name, value in found.wilcoxon_p.items()}
    titles = summary_of(found.scheme)
    of = {name: estimate(found, name) for name in titles}
    whole = [
        (title, printed(name, of[name], sign="+"), p.get(name, "-"))
        for name, title in titles.items()
        if of[name].known
    ]
    parts = [
        (part.title, *(printed(name, estimate(found, name, part.id), sign="+") for name in OF_PARTS))
        for part in found.scheme.parts
    ]
    frames = "the same frames" if found.paired else "different frames"
    heading = ("score", "difference [95 % interval]", "Wilcoxon p")
    recall = {part.title: estimate(found, "recall", part.id) for part in found.scheme.parts}
    tables = (
        table(heading, whole, f"{found.a} minus {found.b}, on {frames}"),
        table(("part", *(f"{title} [95 % interval]" for title in OF_PARTS.values())), parts),
        *([joint_text(found.joints, sign="+")] if found.joints else []),
        _extremes(recall, "most gained", "least", sign="+"),
    )
    return block(*tables)


def joint_text(found: JointEstimates | JointDifference, sign: str = "") -> Block:
    """Return a table of the scores of joints, with 95 % intervals, by visibility and by joint.

    The share within the largest distance is left out, so that the table fits a terminal.
    """
    shown = SCORES[:-1]
    of = {group: [joint_estimate(found, name, group) for name in shown] for group in GROUPS}
    rows = [
        (group.replace("_", " "), *(printed(*pair, sign) for pair in zip(shown, scores, strict=True)))
        for group, scores in of.items()
        if any(score.known for score in scores)
    ]
    return table(("joints", *(JOINT_SCORES[name] for name in shown)), rows, "Joints [95 % interval]")


def _extremes(recall: Mapping[str, Estimate], best: str, worst: str, sign: str = "") -> str:
    """Return the parts of the highest and the lowest recall as one line."""
    known = {title: one.value for title, one in recall.items() if one.known}
    if not known:
        return "The truth has 0 parts."
    ends = ((best, max(known, key=known.__getitem__)), (worst, min(known, key=known.__getitem__)))
    named = (f"{word} {title} ({known[title]:{sign}.3f})" for word, title in ends)
    return f"Recall by part: {', '.join(named)}"
