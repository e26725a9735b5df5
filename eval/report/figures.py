"""Figures of the report, made with plotly."""

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from annotate.array_types import Float64
from annotate.correction.audit import Audit
from annotate.parts import BODY_PARTS, PARTS
from eval.compare import paper_results as paper
from eval.compare.paired import Difference
from eval.compare.results import Result
from eval.report.estimates import SHOWN_ORDER, Estimate, difference_of, estimate, row_shares
from eval.report.frame_images import ERROR_KINDS, ERROR_RGB, THERMAL_RANGE_C
from eval.report.gallery import Scene
from eval.report.gather import Material
from eval.report.training_history import Training
from eval.scores import confusion
from eval.scores.boundary import TOLERANCES_MM, TOLERANCES_PX
from eval.scores.reliability import reliability_curve
from eval.scores.scores import DISTANCES

COLORS = ("#3f84d9", "#2a9d6f", "#d8553f", "#8a63d2", "#b08a1e")
PAPER_COLOR = "#858b96"
AROUND_RGB = (84, 86, 94)
"""Colour of the surroundings in a point cloud."""
SPREAD_FRAMES = 10_000  # frames in the distribution by person, evenly spread, half a megabyte
CURVE_POINTS = 400  # points of a loss curve
SMOOTHED = 5  # frames in a running mean of seconds
RARE = 0.001  # least share of the pixels in a bin of confidence
THRESHOLDS_MM = np.arange(0, 301, 10)


def figures_of(material: Material) -> dict[str, go.Figure]:
    """Return every figure by its id; figures without data are left out."""
    results, found = material.results, material.differences
    figures = {
        "overview": _overview(results, material.ceiling),
        "parts-recall": _by_part(results, "recall", material.ceiling),
        "parts-iou": _by_part(results, "iou", material.ceiling),
        "error-kinds": _error_kinds(results),
        "error-distance": _error_distance(results),
        "boundary": _boundary(results),
        "people": _people(results),
        **{f"confusion-{i}": _confusion(row_shares(r.comparison.confusion)) for i, r in enumerate(results)},
        **{f"paper-{i}": _confusion(one.table) for i, one in enumerate((paper.SYNTHETIC, paper.REAL))},
        **{f"scene-{i}": _scene(scene) for i, scene in enumerate(material.scenes)},
    }
    if any(result.comparison.has_confidence for result in results):
        figures["reliability"] = _reliability(results)
    if found:
        figures["differences"] = _differences(found)
    if any(result.comparison.joints_mm is not None for result in results):
        figures["pck"] = _pck(results)
    if material.trainings:
        figures |= {"loss": _loss(material.trainings), "learning": _learning(material.trainings)}
    if any(len(audit.course) > 1 for audit in material.audits.values()):
        figures["effort"] = _effort(material.audits)
    return {name: figure for name, figure in figures.items() if figure.data}


def plain(text: str, most: int = 60) -> str:
    """Return text that plotly prints literally: markup escaped, cut to ``most`` characters."""
    text = text if len(text) <= most else text[: most - 1] + "…"
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def color(number: int) -> str:
    """Return the colour of a result by its index; the colours repeat from the sixth result on."""
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
    """Return the intervals as plotly's error bars; length 0 without an interval."""
    ends = [(e.high - e.value, e.value - e.low) if e.bounded else (0.0, 0.0) for e in found]
    above, below = np.array(ends).T
    return {"type": "data", "array": above, "arrayminus": below, "symmetric": False, "width": 0}


def _row(title: str, names: Sequence[str], found: Sequence[Estimate], hue: str) -> go.Scatter:
    x = [e.value for e in found]
    marker = {"color": hue, "size": 8}
    bars = _errors(found)
    row = go.Scatter(x=x, y=names, name=plain(title), mode="markers", marker=marker, error_x=bars)
    return row.update(orientation="h", offsetgroup=hue, alignmentgroup="rows")


def _rows(traces: Sequence[go.Scatter], count: int, axis: str) -> go.Figure:
    """Return a figure with one row per name, the first on top, and a name's traces beside each other."""
    figure = _figure(traces, 90 + 20 * count * max(1, len(traces) // 2), axis, "")
    return figure.update_layout(scattermode="group").update_yaxes(autorange="reversed", type="category")


def _overview(results: Sequence[Result], ceiling: Result | None) -> go.Figure:
    traces = [
        _row(r.title, [plain(r.title, 28)], [estimate(r.comparison, "mean_recall")], color(i))
        for i, r in enumerate(results)
    ]
    for one, symbol in ((paper.SYNTHETIC, "diamond-open"), (paper.REAL, "diamond")):
        marker = {"symbol": symbol, "size": 10, "color": PAPER_COLOR}
        traces.append(go.Scatter(x=[one.mean_recall], y=[one.title], mode="markers", marker=marker))
    figure = _figure(traces, 80 + 32 * len(traces), "mean recall", "")
    if ceiling is not None:
        at = float(ceiling.comparison.scores["mean_recall"])
        figure.add_vline(at, line_dash="dash", line_color=PAPER_COLOR, annotation_text="two people's labels")
    return figure.update_layout(showlegend=False).update_yaxes(autorange="reversed", type="category")


def _by_part(results: Sequence[Result], name: str, ceiling: Result | None) -> go.Figure:
    names = [part.title for part in BODY_PARTS]
    traces = [
        _row(r.title, names, [estimate(r.comparison, name, part.id) for part in BODY_PARTS], color(i))
        for i, r in enumerate(results)
    ]
    marks = [(one.title, np.diagonal(one.table)[1:]) for one in (paper.SYNTHETIC, paper.REAL)]
    marks = marks if name == "recall" else []
    if ceiling is not None:
        marks.append(("Two people's labels", ceiling.comparison.scores[name][1:]))
    for symbol, (title, values) in zip(("diamond-open", "diamond", "line-ns-open"), marks, strict=False):
        marker = {"symbol": symbol, "size": 9, "color": PAPER_COLOR}
        traces.append(go.Scatter(x=values, y=names, name=title, mode="markers", marker=marker))
    axis = "recall" if name == "recall" else "intersection over union"
    return _rows(traces, len(names), axis)


def _differences(found: Sequence[Difference]) -> go.Figure:
    names = ["All parts", *(part.title for part in BODY_PARTS)]
    traces = []
    for i, one in enumerate(found):
        of_parts = [difference_of(one, "recall", part.id) for part in BODY_PARTS]
        traces.append(_row(one.a, names, [difference_of(one, "mean_recall"), *of_parts], color(i + 1)))
    figure = _rows(traces, len(names), f"recall less that of {plain(found[0].b, 28)}")
    return figure.update_xaxes(zeroline=True)


def _error_kinds(results: Sequence[Result]) -> go.Figure:
    titles = [plain(result.title, 28) for result in results]
    by_result = [confusion.error_kinds(result.comparison.confusion) for result in results]
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


def _curve(title: str, x: object, y: object, number: int, dash: str = "solid") -> go.Scatter:
    line = {"color": color(number), "dash": dash}
    return go.Scatter(x=x, y=y, name=plain(title), mode="lines+markers", line=line, marker={"size": 5})


def _error_distance(results: Sequence[Result]) -> go.Figure:
    labels, traces = [name.replace(" px", "") for name in DISTANCES], []
    for i, result in enumerate(results):
        rates = [estimate(result.comparison, "error_by_distance", k) for k in range(len(labels))]
        curve = _curve(result.title, labels, [rate.value for rate in rates], i)
        traces.append(curve.update(error_y=_errors(rates)))
    figure = _figure(traces, 300, "distance to the nearest border of the truth, px", "wrong pixels")
    return figure.update_yaxes(tickformat=".0%", rangemode="tozero").update_xaxes(type="category")


def _boundary(results: Sequence[Result]) -> go.Figure:
    traces = []
    for i, result in enumerate(results):
        for unit, limits, dash in (("px", TOLERANCES_PX, "solid"), ("mm", TOLERANCES_MM, "dot")):
            scores = result.comparison.scores[f"boundary_f_{unit}"]
            if np.isfinite(scores).any():
                labels = [f"{limit:g} {unit}" for limit in limits]
                traces.append(_curve(f"{result.title}, {unit}", labels, scores, i, dash))
    return _figure(traces, 300, "tolerance", "boundary F").update_xaxes(type="category")


def _reliability(results: Sequence[Result]) -> go.Figure:
    traces = []
    for i, result in enumerate(results):
        if result.comparison.has_confidence:
            for half, where, dash in ((0, "inside", "solid"), (1, "border", "dot")):
                curve = reliability_curve(result.comparison.total.reliability[half])
                often = curve.pixels >= RARE * curve.pixels.sum()
                x, y = (np.where(often, values, np.nan) for values in (curve.confidence, curve.accuracy))
                traces.append(_curve(f"{result.title[:18]}, {where}", x, y, i, dash))
    figure = _figure(traces, 380, "confidence", "share right").update_xaxes(range=[0, 1.01])
    line = {"color": PAPER_COLOR, "dash": "dash"}
    return figure.update_yaxes(range=[0, 1.01]).add_shape(type="line", x0=0, y0=0, x1=1, y1=1, line=line)


def _people(results: Sequence[Result]) -> go.Figure:
    traces = []
    for i, result in enumerate(results):
        c = result.comparison
        frames = np.linspace(0, len(c.frame_ids) - 1, min(SPREAD_FRAMES, len(c.frame_ids))).astype(int)
        people, text = ([plain(names[f], 16) for f in frames] for names in (c.subjects, c.frame_ids))
        traces.append(
            go.Box(x=people, y=c.frame_miou[frames], text=text, name=plain(result.title, 28),
                   boxpoints="all" if len(frames) <= 1000 else "outliers", marker_color=color(i))
        )  # fmt: skip
    return _figure(traces, 340, "", "mIoU of a frame").update_layout(boxmode="group")


def _pck(results: Sequence[Result]) -> go.Figure:
    traces = []
    for i, result in enumerate(results):
        if (errors := result.comparison.joints_mm) is not None:
            scored = errors[~np.isnan(errors)]
            shares = (scored[:, None] <= THRESHOLDS_MM).mean(0)
            traces.append(_curve(result.title, THRESHOLDS_MM, shares, i))
    figure = _figure(traces, 300, "distance to the true joint, mm", "share of the joints")
    return figure.update_yaxes(tickformat=".0%", range=[0, 1.01])


def _loss(trainings: Sequence[Training]) -> go.Figure:
    traces = []
    for i, training in enumerate(trainings):
        points = training.points[:: max(1, len(training.points) // CURVE_POINTS)]
        traces.append(_curve(training.title, points[:, 0], points[:, 1], i).update(mode="lines"))
    return _figure(traces, 300, "images seen", "training loss per pixel").update_yaxes(type="log")


def _learning(trainings: Sequence[Training]) -> go.Figure:
    traces = [
        _curve(f"{training.title}, {name}", training.epochs[:, 0], training.epochs[:, column], i, dash)
        for i, training in enumerate(trainings)
        for column, name, dash in ((2, "mean recall", "solid"), (3, "mIoU", "dot"))
        if np.isfinite(training.epochs[:, column]).any()
    ]
    return _figure(traces, 300, "epoch", "on held-out frames")


def _effort(audits: Mapping[str, Audit]) -> go.Figure:
    """Return seconds of each frame in the order of work, a curve for each step of fine-tuning."""
    traces = []
    for i, (title, audit) in enumerate(audits.items()):
        seconds = [frame.seconds for frame in audit.course]
        smooth = [float(np.mean(seconds[max(0, n + 1 - SMOOTHED) : n + 1])) for n in range(len(seconds))]
        for step in sorted({frame.step for frame in audit.course}):
            own = [n for n, frame in enumerate(audit.course) if frame.step == step]
            name = f"{title}, fine-tuned {int(step)}" if step else title
            dash = "dash" if step else "solid"
            traces.append(_curve(name, [n + 1 for n in own], [smooth[n] for n in own], i, dash))
    return _figure(traces, 300, "frame, in the order of work", "active seconds")


def _confusion(shares: Float64) -> go.Figure:
    """Return a heat map of shares (12, 12) of each true part, in the order of the paper's tables."""
    order = list(SHOWN_ORDER)
    names = [PARTS[i].title for i in order]
    shown = shares[np.ix_(order, order)]
    text = [["" if not v >= 0.005 else f"{v:.2f}" for v in row] for row in shown]
    heat = go.Heatmap(z=shown, x=names, y=names, text=text, texttemplate="%{text}", zmin=0, zmax=1,
                      colorscale="Blues", showscale=False, textfont={"size": 10})  # fmt: skip
    figure = _figure([heat], 460, "label (columns), true part (rows)", "")
    return figure.update_yaxes(autorange="reversed").update_xaxes(tickangle=-45, automargin=True)


def _scene(scene: Scene) -> go.Figure:
    """Return a point cloud that turns, with a menu of its colourings."""
    x, y, z = scene.points_mm.T
    cloud = go.Scatter3d(x=x, y=z, z=-y, mode="markers", hoverinfo="skip", marker={"size": 1.6})
    figure = go.Figure(cloud)
    hidden = {"visible": False}
    buttons = [
        {"method": "restyle", "label": name.removesuffix("_c"), "args": [_coloring(name, values)]}
        for name, values in scene.colors.items()
    ]
    first = _coloring(*next(iter(scene.colors.items())))
    figure.data[0].marker.update({key.removeprefix("marker."): value[0] for key, value in first.items()})
    camera = {"eye": {"x": 0, "y": -1.8, "z": 0.3}}
    figure.update_layout(
        template="none", height=460, paper_bgcolor="#18181c", margin={"l": 0, "r": 0, "t": 0, "b": 0},
        scene={"xaxis": hidden, "yaxis": hidden, "zaxis": hidden, "aspectmode": "data", "camera": camera},
        updatemenus=[{"buttons": buttons, "x": 0, "xanchor": "left", "y": 1, "yanchor": "top",
                      "bgcolor": "#dddddd", "font": {"color": "#18181c"}}],
    )  # fmt: skip
    return figure


def _coloring(name: str, values: NDArray[np.generic]) -> dict[str, list[object]]:
    """Return plotly's marker properties for a colouring of ``Scene.colors``."""
    if name == "temperature_c":
        low, high = THERMAL_RANGE_C
        shown = np.nan_to_num(values.astype(np.float64), nan=low).round(1)
        return {"marker.color": [shown.tolist()], "marker.colorscale": ["Inferno"],
                "marker.cmin": [low], "marker.cmax": [high]}  # fmt: skip
    palette = [AROUND_RGB, *(ERROR_RGB[1:] if name == "error" else (part.rgb for part in PARTS[1:]))]
    ids = values.astype(np.int64)
    kinds = np.where(ids < len(palette), ids, 0)
    last = len(palette) - 1
    scale = [[i / last, _css(rgb)] for i, rgb in enumerate(palette)]
    return {"marker.color": [kinds.tolist()], "marker.colorscale": [scale],
            "marker.cmin": [0], "marker.cmax": [last]}  # fmt: skip


def _css(rgb: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*rgb)
