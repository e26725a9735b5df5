"""Figures of a report, by the id of the element that shows them."""

from collections.abc import Mapping, Sequence

import numpy as np

from annotate.correction.audit import Audit
from annotate.parts import BODY_PARTS
from eval.compare import paper_results as paper
from eval.compare.paired import Difference
from eval.compare.results import Result
from eval.report import charts
from eval.report.charts import Figure
from eval.report.estimates import Estimate, difference_of
from eval.report.frame_images import ERROR_KINDS
from eval.report.gather import Material
from eval.report.training_history import Training
from eval.report.views import THRESHOLDS_MM, JointsView, ResultView
from eval.scores.boundary import TOLERANCES_MM, TOLERANCES_PX
from eval.scores.reliability import reliability_curve

CURVE_POINTS = 400
"""Points of a loss curve at most; chosen by eye."""
SPREAD_FRAMES = 10_000
"""Frames in the distribution of scores by person, evenly spread, half a megabyte; chosen by eye."""
SMOOTHED = 5
"""Frames whose mean a point of the curve of effort is: one alone varies tenfold; chosen by eye."""
RARE = 0.001
"""Least share of the pixels in a bin of confidence that the curve shows; chosen by eye."""


def figures_of(material: Material, joints: Sequence[JointsView]) -> dict[str, Figure]:
    """Every figure by its id; those without data are left out."""
    results, views, found = material.results, material.views, material.differences
    errors = [
        (v.result.title, [(*ERROR_KINDS[kind], share) for kind, share in v.errors.items()]) for v in views
    ]
    figures = {
        "overview": _overview(views, material.ceiling),
        "parts-recall": _by_part(views, "recall", "recall", material.ceiling),
        "parts-iou": _by_part(views, "iou", "intersection over union", material.ceiling),
        "error-kinds": charts.stacked_shares(errors),
        "error-distance": _error_distance(views),
        "boundary": _boundary(results),
        "people": _people(results),
    }
    if any(result.comparison.has_confidence for result in results):
        figures["reliability"] = _reliability(results)
    if found:
        figures["differences"] = _differences(found)
    if joints:
        figures["pck"] = _pck(joints, results)
    if material.trainings:
        figures |= {"loss": _loss(material.trainings), "learning": _learning(material.trainings)}
        if not any(np.isfinite(training.epochs[:, 2]).any() for training in material.trainings):
            del figures["learning"]
    if any(len(audit.course) > 1 for audit in material.audits.values()):
        figures["effort"] = _effort(material.audits)
    return figures


def _overview(views: Sequence[ResultView], ceiling: Result | None) -> Figure:
    rows = [
        (v.result.title, v.scores["mean_recall"], charts.series(i), "circle") for i, v in enumerate(views)
    ]
    for of_paper, symbol in ((paper.SYNTHETIC, "diamond-open"), (paper.REAL, "diamond")):
        printed = Estimate(of_paper.mean_recall, np.nan, np.nan)
        rows.append((of_paper.title, printed, "var(--paper)", symbol))
    figure = charts.levels(rows, "mean recall")
    if ceiling is not None:
        _line_at(figure, float(ceiling.comparison.scores["mean_recall"]), "two people's labels")
    return figure


def _line_at(figure: Figure, x: float, text: str) -> None:
    """Add a dashed line across the rows, with its name."""
    line = {"color": "var(--soft)", "width": 1.5, "dash": "dash"}
    ends = {"x0": x, "x1": x, "y0": 0, "y1": 1, "yref": "paper"}
    place = {"x": x, "y": 1, "yref": "paper", "yanchor": "bottom", "xanchor": "right"}
    figure["layout"]["shapes"] = [{"type": "line", **ends, "line": line}]
    figure["layout"]["annotations"] = [{**place, "text": text, "showarrow": False}]
    figure["layout"]["margin"]["t"] = 24


def _by_part(views: Sequence[ResultView], name: str, axis: str, ceiling: Result | None) -> Figure:
    by_part = zip(*(view.parts for view in views), strict=True)
    rows = [(found[0].part.title, [row.scores[name] for row in found]) for found in by_part]
    best = None if ceiling is None else ceiling.comparison.scores[name][1:].tolist()
    of_paper = (paper.SYNTHETIC, paper.REAL) if name == "recall" else ()
    references = {one.title: np.diagonal(one.table)[1:].tolist() for one in of_paper}
    return charts.forest(rows, [view.result.title for view in views], axis, references, best)


def _error_distance(views: Sequence[ResultView]) -> Figure:
    traces, bands = [], []
    for i, view in enumerate(views):
        labels, rates = [row.label for row in view.distances], [row.rate for row in view.distances]
        traces.append((view.result.title, labels, [e.value for e in rates], charts.series(i), "solid"))
        bands += charts.band(labels, rates, charts.pale(i))
    layout = {"yaxis": {"tickformat": ".0%", "rangemode": "tozero"}, "xaxis": {"type": "category"}}
    figure = charts.lines(traces, "distance to the nearest border of the truth, px", "wrong pixels", layout)
    figure["data"] = [*bands, *figure["data"]]
    return figure


def _boundary(results: Sequence[Result]) -> Figure:
    traces = []
    for i, result in enumerate(results):
        for name, limits, dash, unit in (
            ("boundary_f_px", TOLERANCES_PX, "solid", "px"),
            ("boundary_f_mm", TOLERANCES_MM, "dot", "mm"),
        ):
            scores = result.comparison.scores[name]
            if np.isfinite(scores).any():
                labels = [f"{limit:g} {unit}" for limit in limits]
                traces.append((f"{result.title}, {unit}", labels, scores.tolist(), charts.series(i), dash))
    return charts.lines(traces, "tolerance", "boundary F", {"xaxis": {"type": "category"}})


def _reliability(results: Sequence[Result]) -> Figure:
    traces = []
    for i, result in enumerate(results):
        if result.comparison.has_confidence:
            for half, where, dash in ((0, "inside", "solid"), (1, "border", "dot")):
                curve = reliability_curve(result.comparison.total.reliability[half])
                often = curve.pixels >= RARE * curve.pixels.sum()
                x, y = np.where(often, curve.confidence, np.nan), np.where(often, curve.accuracy, np.nan)
                title = f"{result.title[:18]}, {where}"
                traces.append((title, charts.numbers(x), y.tolist(), charts.series(i), dash))
    unit = {"range": [0, 1.01]}
    figure = charts.lines(traces, "confidence", "share right", {"xaxis": unit, "yaxis": unit}, 380)
    diagonal = {"color": "var(--soft)", "width": 1.2, "dash": "dash"}
    figure["layout"]["shapes"] = [{"type": "line", "x0": 0, "y0": 0, "x1": 1, "y1": 1, "line": diagonal}]
    return figure


def _differences(found: Sequence[Difference]) -> Figure:
    titles = [one.a for one in found]
    rows = [("All parts", [difference_of(one, "mean_recall") for one in found])]
    rows += [(part.title, [difference_of(one, "recall", part.id) for one in found]) for part in BODY_PARTS]
    axis = f"recall less that of {charts.short(found[0].b)}"
    return charts.forest(rows, titles, axis, first_series=1, zero=True)


def _people(results: Sequence[Result]) -> Figure:
    boxes = []
    for i, result in enumerate(results):
        c = result.comparison
        frames = np.linspace(0, len(c.frame_ids) - 1, min(SPREAD_FRAMES, len(c.frame_ids))).astype(int)
        people = [c.subjects[f] for f in frames]
        text = [f"{c.frame_ids[f]}, {who}" for f, who in zip(frames, people, strict=True)]
        boxes.append((result.title, people, c.frame_miou[frames], text, charts.series(i)))
    return charts.spreads(boxes, "mIoU of a frame")


def _pck(joints: Sequence[JointsView], results: Sequence[Result]) -> Figure:
    order = [result.title for result in results]
    traces = [
        (j.title, list(THRESHOLDS_MM), j.pck, charts.series(order.index(j.title)), "solid") for j in joints
    ]
    layout = {"yaxis": {"tickformat": ".0%", "range": [0, 1.01]}}
    return charts.lines(traces, "distance to the true joint, mm", "share of the joints", layout)


def _loss(trainings: Sequence[Training]) -> Figure:
    traces = []
    for i, training in enumerate(trainings):
        points = training.points[:: max(1, len(training.points) // CURVE_POINTS)]
        traces.append(
            (training.title, charts.numbers(points[:, 0]), points[:, 1].tolist(), charts.series(i), "solid")
        )
    figure = charts.lines(traces, "images seen", "training loss per pixel", {"yaxis": {"type": "log"}})
    for trace in figure["data"]:
        trace["mode"] = "lines"
    return figure


def _effort(audits: Mapping[str, Audit]) -> Figure:
    """Seconds of each frame in the order of work; after each step of learning a curve of its own."""
    traces = []
    for i, (title, audit) in enumerate(audits.items()):
        steps = sorted({frame.step for frame in audit.course})
        seconds = _smoothed([frame.seconds for frame in audit.course])
        for step in steps:
            own = [n for n, frame in enumerate(audit.course) if frame.step == step]
            name = f"{title}, learnt {int(step)}" if step else title
            x, y = charts.numbers(np.array(own) + 1.0), [seconds[n] for n in own]
            traces.append((name, x, y, charts.series(i), "dash" if step else "solid"))
    return charts.lines(traces, "frame, in the order of work", "active seconds")


def _smoothed(seconds: Sequence[float]) -> list[float]:
    """Mean of each frame's seconds and of those before it, SMOOTHED at most."""
    return [float(np.mean(seconds[max(0, n + 1 - SMOOTHED) : n + 1])) for n in range(len(seconds))]


def _learning(trainings: Sequence[Training]) -> Figure:
    traces = []
    for i, training in enumerate(trainings):
        for column, name, dash in ((2, "mean recall", "solid"), (3, "mIoU", "dot")):
            scores = training.epochs[:, column]
            if np.isfinite(scores).any():
                x = charts.numbers(training.epochs[:, 0])
                traces.append((f"{training.title}, {name}", x, scores.tolist(), charts.series(i), dash))
    return charts.lines(traces, "epoch", "on frames held out")
