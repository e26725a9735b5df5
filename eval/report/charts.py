"""Figures for plotly.js as plain JSON values: what is drawn; the page's script gives them its colours.

A colour is written `var(--name)` and looked up in the page's style sheet, so that one figure serves light,
dark and paper. Text from outside goes through `plain`, since plotly reads some markup in text.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float64
from eval.report.estimates import Estimate

Figure: TypeAlias = dict[str, Any]
"""``data`` (traces) and ``layout`` as in plotly.js; numbers that are not known are None."""

SERIES = 5
"""Colours of results in the style sheet; the sixth result has the first one's again."""

ROW_PX, FRAME_PX = 17, 64
"""Pixels of a point's line and of what surrounds a figure's lines; chosen by eye."""

SINGLE_POINTS = 1000
"""Values that a distribution shows one by one; beyond that only the outliers; chosen by eye."""


def plain(text: str) -> str:
    """Text as plotly shows it letter by letter: its markup, links among it, escaped."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def short(text: str, most: int = 28) -> str:
    """Text for an axis or a legend: `plain`, and cut where it would push the figure aside."""
    return plain(text if len(text) <= most else text[: most - 1] + "…")


def series(number: int) -> str:
    """Colour of a result by its place among the results."""
    return f"var(--s{number % SERIES})"


def pale(number: int) -> str:
    """The same colour, nearly transparent."""
    return f"var(--b{number % SERIES})"


def numbers(values: NDArray[np.generic] | Sequence[float]) -> list[float | None]:
    """Values as JSON has them, to five digits: what is not finite becomes None."""
    return [float(f"{v:.5g}") if np.isfinite(v) else None for v in np.asarray(values, np.float64).ravel()]


def figure(data: list[Figure], height: int, layout: Figure) -> Figure:
    """A figure of this height in pixels, its legend above if it has more than one entry."""
    margin = {"l": 56, "r": 14, "t": 8, "b": 42, **layout.get("margin", {})}
    legend = {"orientation": "h", "x": 0, "y": 1.0, "yanchor": "bottom", "traceorder": "normal"}
    shared = {"height": height, "legend": legend, "showlegend": len(data) > 1}
    return {"data": data, "layout": {**shared, **layout, "margin": margin}}


def forest(
    rows: Sequence[tuple[str, Sequence[Estimate]]],
    titles: Sequence[str],
    axis: str,
    references: Mapping[str, Sequence[float]] = MappingProxyType({}),
    ceiling: Sequence[float] | None = None,
    first_series: int = 0,
    zero: bool = False,
) -> Figure:
    """One line per row with one point and its interval for each title.

    references: the paper's values by name, one a row, hollow diamonds first and full ones second. ceiling:
    what two people's labels come to, one a row. zero: the axis is a difference's, with a line at 0.
    """
    names = [short(name) for name, _ in rows]
    data: list[Figure] = []
    for k, title in enumerate(titles):
        found = [estimates[k] for _, estimates in rows]
        offset = (k - (len(titles) - 1) / 2) * min(0.22, 0.7 / max(len(titles), 1))
        data.append(_points(short(title), found, offset, series(first_series + k), names))
    for symbol, (name, values) in zip(("diamond-open", "diamond"), references.items(), strict=False):
        data.append(_marks(name, values, symbol, names))
    if ceiling is not None:
        data.append(_marks("Two people's labels", ceiling, "line-ns-open", names))
    height = FRAME_PX + 30 + len(rows) * max(26, ROW_PX * len(titles))
    x: Figure = {"title": {"text": axis}, "zeroline": zero, "range": None if zero else _span(data)}
    return figure(data, height, {"xaxis": x, "yaxis": _row_axis(names), "margin": {"l": 130}})


def _row_axis(names: Sequence[str]) -> Figure:
    """The axis of one line a name, the first on top."""
    return {
        "tickvals": list(range(len(names))),
        "ticktext": list(names),
        "range": [len(names) - 0.5, -0.5],
        "zeroline": False,
    }


def _points(title: str, found: Sequence[Estimate], offset: float, color: str, names: Sequence[str]) -> Figure:
    value = np.array([e.value for e in found])
    above = np.array([e.high - e.value if e.bounded else 0.0 for e in found])
    below = np.array([e.value - e.low if e.bounded else 0.0 for e in found])
    text = [
        f"{name}: {e.value:.3f}" + (f" ({e.low:.3f} to {e.high:.3f})" if e.bounded else "")
        for name, e in zip(names, found, strict=True)
    ]
    errors = {"type": "data", "array": numbers(above), "arrayminus": numbers(below), "symmetric": False,
              "thickness": 2, "width": 0, "color": color}  # fmt: skip
    return {
        "type": "scatter", "mode": "markers", "name": title, "x": numbers(value),
        "y": [float(i + offset) for i in range(len(found))], "error_x": errors,
        "marker": {"color": color, "size": 8}, "hovertext": text, "hoverinfo": "text+name",
    }  # fmt: skip


def _marks(name: str, values: Sequence[float], symbol: str, names: Sequence[str]) -> Figure:
    text = [f"{row}: {value:.3f}" for row, value in zip(names, values, strict=True)]
    color = "var(--soft)" if symbol == "line-ns-open" else "var(--paper)"
    size = 18 if symbol == "line-ns-open" else 9
    return {
        "type": "scatter", "mode": "markers", "name": name, "x": numbers(values),
        "y": list(range(len(values))), "hovertext": text, "hoverinfo": "text+name",
        "marker": {"symbol": symbol, "size": size, "color": color, "line": {"width": 1.6, "color": color}},
    }  # fmt: skip


def _span(data: Sequence[Figure]) -> list[float]:
    """From a tenth below the lowest value shown up to 1."""
    ends = [v for trace in data for v in trace["x"] if v is not None]
    for trace in data:
        spread = trace.get("error_x", {}).get("arrayminus", [])
        ends += [v - e for v, e in zip(trace["x"], spread, strict=False) if v is not None and e is not None]
    lowest = float(np.floor(min(ends, default=0.0) * 10) / 10)
    return [max(0.0, min(lowest, 0.9)), 1.005]


def levels(rows: Sequence[tuple[str, Estimate, str, str]], axis: str) -> Figure:
    """One line and one point with its interval a row: (name, estimate, colour, plotly's symbol)."""
    names = [short(name) for name, *_ in rows]
    data = []
    for i, (_, found, color, symbol) in enumerate(rows):
        trace = _points(names[i], [found], i, color, [names[i]])
        trace["marker"] |= {"symbol": symbol, "size": 10}
        data.append(trace)
    x = {"title": {"text": axis}, "range": _span(data), "zeroline": False}
    layout = {"xaxis": x, "yaxis": _row_axis(names), "margin": {"l": 150}, "showlegend": False}
    return figure(data, FRAME_PX + 32 * len(rows), layout)


def lines(
    traces: Sequence[tuple[str, Sequence[Any], Sequence[float], str, str]],
    x_title: str,
    y_title: str,
    layout: Figure | None = None,
    height: int = 300,
) -> Figure:
    """Curves: (name, x, y, colour, dash). layout: what goes beyond the axes' titles."""
    data = [
        {"type": "scatter", "mode": "lines+markers", "name": short(name), "x": list(x), "y": numbers(y),
         "line": {"color": color, "width": 2, "dash": dash}, "marker": {"size": 5, "color": color}}
        for name, x, y, color, dash in traces
    ]  # fmt: skip
    layout = layout or {}
    x_axis = {"title": {"text": x_title}, **layout.get("xaxis", {})}
    y_axis = {"title": {"text": y_title}, **layout.get("yaxis", {})}
    return figure(data, height, {**layout, "xaxis": x_axis, "yaxis": y_axis})


def band(x: Sequence[Any], found: Sequence[Estimate], color: str) -> list[Figure]:
    """A curve's interval as a pale band, without an entry of its own in the legend."""
    low = [e.low if e.bounded else e.value for e in found]
    high = [e.high if e.bounded else e.value for e in found]
    shared = {"type": "scatter", "mode": "lines", "x": list(x), "line": {"width": 0}, "hoverinfo": "skip",
              "showlegend": False}  # fmt: skip
    return [
        {**shared, "y": numbers(low)},
        {**shared, "y": numbers(high), "fill": "tonexty", "fillcolor": color},
    ]


def stacked_shares(rows: Sequence[tuple[str, Sequence[tuple[str, tuple[int, int, int], float]]]]) -> Figure:
    """One bar a row, its shares (name, RGB, share) side by side."""
    kinds = [(name, rgb) for name, rgb, _ in rows[0][1]]
    titles = [short(title) for title, _ in rows]
    data = [
        {"type": "bar", "orientation": "h", "name": name, "y": list(range(len(rows))),
         "x": numbers([shares[k][2] for _, shares in rows]),
         "marker": {"color": "rgb({},{},{})".format(*rgb)},
         "hovertext": [f"{title}: {name} {shares[k][2]:.1%} of the errors"
                       for title, (_, shares) in zip(titles, rows, strict=True)], "hoverinfo": "text"}
        for k, (name, rgb) in enumerate(kinds)
    ]  # fmt: skip
    x = {"tickformat": ".0%", "range": [0, 1], "title": {"text": "share of the wrong pixels"}}
    y = {"tickvals": list(range(len(rows))), "ticktext": titles, "autorange": "reversed", "showgrid": False}
    height = FRAME_PX + 70 + 34 * len(rows)
    layout = {"barmode": "stack", "bargap": 0.35, "xaxis": x, "yaxis": y, "margin": {"l": 150, "t": 60}}
    return figure(data, height, layout)


def spreads(boxes: Sequence[tuple[str, Sequence[str], Float64, Sequence[str], str]], y_title: str) -> Figure:
    """Distributions by group, every value a point: (name, group of each, values, text of each, colour)."""
    data = [
        {"type": "box", "name": short(name), "x": [short(g, 16) for g in group], "y": numbers(values),
         "text": [plain(t) for t in text], "hoverinfo": "text+y",
         "boxpoints": "all" if len(values) <= SINGLE_POINTS else "outliers", "jitter": 0.5, "pointpos": 0,
         "marker": {"size": 4, "color": color, "opacity": 0.75}, "line": {"width": 1.2},
         "fillcolor": "rgba(128,128,128,0.12)"}
        for name, group, values, text, color in boxes
    ]  # fmt: skip
    y = {"title": {"text": y_title}, "zeroline": False}
    return figure(data, 340, {"boxmode": "group", "yaxis": y, "xaxis": {"showgrid": False}})
