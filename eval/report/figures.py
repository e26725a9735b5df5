"""Figures of the report, made with plotly."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from annotate.array_types import Float64
from annotate.correction.audit import Audit
from annotate.scheme.scheme import Part, Scheme
from eval.compare import paper_results as paper
from eval.compare.difference import Difference
from eval.compare.results import Result
from eval.report.estimates import Estimate, Scored, estimate
from eval.report.frame_images import ERROR_KINDS, ERROR_RGB, THERMAL_RANGE_C
from eval.report.gallery import Scene
from eval.report.training_history import Training
from eval.scores.boundary import TOLERANCES_MM, TOLERANCES_PX
from eval.scores.joint_visibility import OUTSIDE
from eval.scores.reliability import reliability_curve
from eval.scores.scores import DISTANCES

COLORS = ("#3f84d9", "#2a9d6f", "#d8553f", "#8a63d2", "#b08a1e")  # of the results, in turn
PAPER_COLOR = "#858b96"
PAPER_SYMBOLS = ("diamond-open", "diamond")  # of the synthetic and the real result
AROUND_RGB = (84, 86, 94)  # surroundings in a point cloud
SPREAD_FRAMES = 10_000  # frames in the distribution by person, evenly spread, half a megabyte
CURVE_POINTS = 400  # points of a loss curve
SMOOTHED = 5  # frames in a running mean of seconds
RARE = 0.001  # least share of the pixels in a bin of confidence
THRESHOLDS_MM = np.arange(0, 301, 10)


def plain(text: str, most: int = 60) -> str:
    """Return text that plotly shows literally: cut to ``most`` characters, markup characters escaped."""
    text = text if len(text) <= most else text[: most - 1] + "…"
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def _color(number: int) -> str:
    return COLORS[number % len(COLORS)]


def _figure(traces: Sequence[object], height: int, x: str, y: str) -> go.Figure:
    figure = go.Figure(list(traces))
    figure.update_layout(
        template="none", height=height, paper_bgcolor="rgba(0,0,0,0)", plot_bgcolor="rgba(0,0,0,0)",
        margin={"l": 60, "r": 14, "t": 10, "b": 44}, showlegend=len(traces) > 1,
        legend={"orientation": "h", "x": 0, "y": 1.0, "yanchor": "bottom"},
    )  # fmt: skip
    grid = {"gridcolor": "rgba(128,128,128,0.25)", "zeroline": False}
    return figure.update_xaxes(title_text=x, **grid).update_yaxes(title_text=y, automargin=True, **grid)


def _errors(found: Sequence[Estimate]) -> dict[str, object]:
    """Return the intervals as plotly's error bars, zero long without an interval."""
    ends = [(e.high - e.value, e.value - e.low) if e.bounded else (0.0, 0.0) for e in found]
    above, below = np.array(ends).T
    return {"type": "data", "array": above, "arrayminus": below, "symmetric": False, "width": 0}


def _row(title: str, names: Sequence[str], found: Sequence[Estimate], number: int) -> go.Scatter:
    marker = {"color": _color(number), "size": 8}
    x, bars = [e.value for e in found], _errors(found)
    row = go.Scatter(x=x, y=names, name=plain(title), mode="markers", marker=marker, error_x=bars)
    return row.update(orientation="h", offsetgroup=_color(number), alignmentgroup="rows")


def _mark(title: str, x: object, names: Sequence[str], symbol: str) -> go.Scatter:
    marker = {"symbol": symbol, "size": 9, "color": PAPER_COLOR}
    return go.Scatter(x=x, y=names, name=title, mode="markers", marker=marker)


def _rows(traces: Sequence[go.Scatter], count: int, axis: str) -> go.Figure:
    """Return a chart with one row for each name, the first on top; its traces lie side by side."""
    figure = _figure(traces, 90 + 20 * count * max(1, len(traces) // 2), axis, "")
    return figure.update_layout(scattermode="group").update_yaxes(autorange="reversed", type="category")


def _curve(title: str, x: object, y: object, number: int, dash: str = "solid") -> go.Scatter:
    line = {"color": _color(number), "dash": dash}
    return go.Scatter(x=x, y=y, name=plain(title), mode="lines+markers", line=line, marker={"size": 5})


def overview(results: Sequence[Result], ceiling: Result | None) -> go.Figure:
    """Return a chart of the mean recall of every result, the paper's, and two people's agreement (the
    ceiling).

    Another scheme's mean recall is over other parts: the paper's needs a result of scheme ``paper``, the
    ceiling's a result of its own scheme.
    """
    schemes = [result.comparison.scheme for result in results]
    traces = [
        _row(r.title, [plain(r.title, 28)], [estimate(r.comparison, "mean_recall")], i)
        for i, r in enumerate(results)
    ]
    for one, symbol in zip(paper.published(schemes), PAPER_SYMBOLS, strict=False):
        traces.append(_mark("", [one.mean_recall], [one.title], symbol))
    figure = _figure(traces, 80 + 32 * len(traces), "mean recall", "")
    if ceiling is not None and ceiling.comparison.scheme in schemes:
        at = float(ceiling.comparison.scores["mean_recall"])
        figure.add_vline(at, line_dash="dash", line_color=PAPER_COLOR, annotation_text="two people's labels")
    return figure.update_layout(showlegend=False).update_yaxes(autorange="reversed", type="category")


def _part_estimates(scored: Scored, name: str, scheme: Scheme) -> list[Estimate]:
    return [estimate(scored, name, part.id) for part in scheme.parts]


def by_part(
    results: Sequence[Result], scheme: Scheme, name: Literal["recall", "iou"], ceiling: Result | None
) -> go.Figure:
    """Return a chart of a score of every part of a scheme, for the results of this scheme.

    In scheme ``paper`` with the paper's recalls; with two people's agreement (the ceiling) of this scheme.
    """
    names = [part.title for part in scheme.parts]
    traces = [
        _row(r.title, names, _part_estimates(r.comparison, name, scheme), i)
        for i, r in enumerate(results)
        if r.comparison.scheme == scheme
    ]
    if name == "recall":
        for one, symbol in zip(paper.published([scheme]), PAPER_SYMBOLS, strict=False):
            traces.append(_mark(one.title, np.diagonal(one.table)[1:], names, symbol))
    if ceiling is not None and ceiling.comparison.scheme == scheme:
        values = [float(ceiling.comparison.scores[name][part.id]) for part in scheme.parts]
        traces.append(_mark("Two people's labels", values, names, "line-ns-open"))
    return _rows(traces, len(names), {"recall": "recall", "iou": "intersection over union"}[name])


def differences(found: Sequence[Difference], scheme: Scheme) -> go.Figure:
    """Return a chart of the differences of recall in a scheme, of all parts and by part."""
    names = ["All parts", *(part.title for part in scheme.parts)]
    traces = [
        _row(one.a, names, [estimate(one, "mean_recall"), *_part_estimates(one, "recall", scheme)], i + 1)
        for i, one in enumerate(found)
        if one.scheme == scheme
    ]
    figure = _rows(traces, len(names), f"recall minus recall of {plain(found[0].b, 28)}")
    return figure.update_xaxes(zeroline=True)


def error_kinds(results: Sequence[Result]) -> go.Figure:
    """Return a chart of the kinds of error as shares of the wrong pixels."""
    titles = [plain(result.title, 28) for result in results]
    by_result = [result.comparison.error_kinds for result in results]
    wrong = [max(sum(map(int, kinds.values())), 1) for kinds in by_result]
    traces = [
        go.Bar(
            y=titles, x=[int(kinds[kind]) / n for kinds, n in zip(by_result, wrong, strict=True)],
            orientation="h", name=ERROR_KINDS[kind][0], marker_color=_css(ERROR_KINDS[kind][1]),
        )
        for kind in by_result[0]
    ]  # fmt: skip
    figure = _figure(traces, 150 + 34 * len(titles), "share of the wrong pixels", "")
    return figure.update_layout(barmode="stack").update_xaxes(tickformat=".0%", range=[0, 1])


def error_distance(results: Sequence[Result]) -> go.Figure:
    """Return a chart of the error rate by distance to a border."""
    labels, traces = [name.replace(" px", "") for name in DISTANCES], []
    for i, result in enumerate(results):
        rates = [estimate(result.comparison, "error_by_distance", k) for k in range(len(labels))]
        curve = _curve(result.title, labels, [rate.value for rate in rates], i)
        traces.append(curve.update(error_y=_errors(rates)))
    figure = _figure(traces, 300, "distance to the nearest border of the truth, px", "wrong pixels")
    return figure.update_yaxes(tickformat=".0%", rangemode="tozero").update_xaxes(type="category")


def boundary(results: Sequence[Result]) -> go.Figure:
    """Return a chart of the boundary F-score by tolerance."""
    traces = []
    for i, result in enumerate(results):
        for unit, limits, dash in (("px", TOLERANCES_PX, "solid"), ("mm", TOLERANCES_MM, "dot")):
            scores = result.comparison.scores[f"boundary_f_{unit}"]
            if np.isfinite(scores).any():
                labels = [f"{limit:g} {unit}" for limit in limits]
                traces.append(_curve(f"{result.title}, {unit}", labels, scores, i, dash))
    return _figure(traces, 300, "tolerance", "boundary F").update_xaxes(type="category")


def reliability(results: Sequence[Result]) -> go.Figure:
    """Return a chart of the accuracy by confidence, inside parts and near borders."""
    traces = []
    for i, result in enumerate(results):
        for half, where, dash in ((0, "inside", "solid"), (1, "border", "dot")):
            curve = reliability_curve(result.comparison.total.reliability[half])
            if curve.pixels.any():
                often = curve.pixels >= RARE * curve.pixels.sum()
                x, y = (np.where(often, values, np.nan) for values in (curve.confidence, curve.accuracy))
                traces.append(_curve(f"{result.title[:18]}, {where}", x, y, i, dash))
    figure = _figure(traces, 380, "confidence", "share right").update_xaxes(range=[0, 1.01])
    line = {"color": PAPER_COLOR, "dash": "dash"}
    return figure.update_yaxes(range=[0, 1.01]).add_shape(type="line", x0=0, y0=0, x1=1, y1=1, line=line)


def people(results: Sequence[Result]) -> go.Figure:
    """Return box plots of the frames' mIoU, one for each person."""
    traces = []
    for i, result in enumerate(results):
        c = result.comparison
        frames = np.linspace(0, len(c.frame_ids) - 1, min(SPREAD_FRAMES, len(c.frame_ids))).astype(int)
        names, text = ([plain(column[f], 16) for f in frames] for column in (c.subjects, c.frame_ids))
        traces.append(
            go.Box(x=names, y=c.frame_miou[frames], text=text, name=plain(result.title, 28),
                   boxpoints="all" if len(frames) <= 1000 else "outliers", marker_color=_color(i))
        )  # fmt: skip
    return _figure(traces, 340, "", "mIoU of a frame").update_layout(boxmode="group")


def over_frames(results: Sequence[Result]) -> go.Figure:
    """Return a chart of the frames' mIoU in the order of the recording."""
    traces = []
    for i, result in enumerate(results):
        c = result.comparison
        chosen = np.linspace(0, len(c.frame_ids) - 1, min(SPREAD_FRAMES, len(c.frame_ids))).astype(int)
        traces.append(_curve(result.title, chosen, c.frame_miou[chosen], i))
    return _figure(traces, 260, "frame, in the order of the recording", "mIoU").update_yaxes(range=[0, 1.01])


def pck(results: Sequence[Result]) -> go.Figure:
    """Return a chart of the share of joints within each distance of the truth."""
    traces = []
    for i, result in enumerate(results):
        if joints := result.comparison.joints:
            scored = joints.errors_mm[~np.isnan(joints.errors_mm) & (joints.visibility != OUTSIDE)]
            shares = (scored[:, None] <= THRESHOLDS_MM).mean(0)
            traces.append(_curve(result.title, THRESHOLDS_MM, shares, i))
    figure = _figure(traces, 300, "distance to the true joint, mm", "share of the joints")
    return figure.update_yaxes(tickformat=".0%", range=[0, 1.01])


def loss(trainings: Sequence[Training]) -> go.Figure:
    """Return a chart of the training losses by images seen."""
    traces = []
    for i, training in enumerate(trainings):
        points = training.points[:: max(1, len(training.points) // CURVE_POINTS)]
        traces.append(_curve(training.title, points[:, 0], points[:, 1], i).update(mode="lines"))
    return _figure(traces, 300, "images seen", "training loss per pixel").update_yaxes(type="log")


def learning(trainings: Sequence[Training]) -> go.Figure:
    """Return a chart of the scores by epoch of trainings."""
    traces = [
        _curve(f"{training.title}, {name}", training.epochs[:, 0], training.epochs[:, column], i, dash)
        for i, training in enumerate(trainings)
        for column, name, dash in ((2, "mean recall", "solid"), (3, "mIoU", "dot"))
        if np.isfinite(training.epochs[:, column]).any()
    ]
    return _figure(traces, 300, "epoch", "on held-out frames")


def effort(audits: Mapping[str, Audit]) -> go.Figure:
    """Return a chart of the seconds of each frame in the order of work, a curve for each step of
    fine-tuning.
    """
    traces = []
    for i, (title, audit) in enumerate(audits.items()):
        seconds = [frame.seconds for frame in audit.course]
        smooth = [float(np.mean(seconds[max(0, n + 1 - SMOOTHED) : n + 1])) for n in range(len(seconds))]
        for step in sorted({frame.step for frame in audit.course}) if len(seconds) > 1 else ():
            own = [n for n, frame in enumerate(audit.course) if frame.step == step]
            name = f"{title}, fine-tuned {int(step)}" if step else title
            dash = "dash" if step else "solid"
            traces.append(_curve(name, [n + 1 for n in own], [smooth[n] for n in own], i, dash))
    return _figure(traces, 300, "frame, in the order of work", "active seconds")


def confusion_matrix(shown: Float64, parts: Sequence[Part]) -> go.Figure:
    """Return a heat map of shares (n, n) of each true part, in the order of ``parts``."""
    names = [part.title for part in parts]
    text = [["" if not v >= 0.005 else f"{v:.2f}" for v in row] for row in shown]
    heat = go.Heatmap(z=shown, x=names, y=names, text=text, texttemplate="%{text}", zmin=0, zmax=1,
                      colorscale="Blues", showscale=False, textfont={"size": 10})  # fmt: skip
    figure = _figure([heat], 460, "label (columns), true part (rows)", "")
    return figure.update_yaxes(autorange="reversed").update_xaxes(tickangle=-45, automargin=True)


def point_cloud(scene: Scene) -> go.Figure:
    """Return a point cloud with a menu of its colourings."""
    x, y, z = scene.points_mm.T
    figure = go.Figure(go.Scatter3d(x=x, y=z, z=-y, mode="markers", hoverinfo="skip", marker={"size": 1.6}))
    colorings = {
        name.removesuffix("_c"): _coloring(name, values, scene.scheme)
        for name, values in scene.colors.items()
    }
    buttons = [{"method": "restyle", "label": name, "args": [one]} for name, one in colorings.items()]
    first = next(iter(colorings.values()))
    figure.data[0].marker.update({key.removeprefix("marker."): value[0] for key, value in first.items()})
    axes = {f"{axis}axis": {"visible": False} for axis in "xyz"}
    camera = {"eye": {"x": 0, "y": -1.8, "z": 0.3}}
    return figure.update_layout(
        template="none", height=460, paper_bgcolor="#18181c", margin={"l": 0, "r": 0, "t": 0, "b": 0},
        scene={**axes, "aspectmode": "data", "camera": camera},
        updatemenus=[{"buttons": buttons, "x": 0, "xanchor": "left", "y": 1, "yanchor": "top",
                      "bgcolor": "#dddddd", "font": {"color": "#18181c"}}],
    )  # fmt: skip


def _coloring(name: str, values: NDArray[np.generic], scheme: Scheme) -> dict[str, list[object]]:
    """Return plotly's marker properties for a colouring of ``Scene.colors``."""
    if name == "temperature_c":
        low, high = THERMAL_RANGE_C
        shown = np.nan_to_num(values.astype(np.float64), nan=low).round(1)
        return {"marker.color": [shown.tolist()], "marker.colorscale": ["Inferno"],
                "marker.cmin": [low], "marker.cmax": [high]}  # fmt: skip
    colors = ERROR_RGB[1:] if name == "error" else scheme.palette_rgb()[1 : scheme.n_classes].tolist()
    palette = [AROUND_RGB, *map(tuple, colors)]
    ids, last = values.astype(np.int64), len(palette) - 1
    kinds = np.where(ids <= last, ids, 0)
    scale = [[i / last, _css(rgb)] for i, rgb in enumerate(palette)]
    return {"marker.color": [kinds.tolist()], "marker.colorscale": [scale],
            "marker.cmin": [0], "marker.cmax": [last]}  # fmt: skip


def _css(rgb: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*rgb)
