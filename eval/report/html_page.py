"""An HTML page of sections that opens offline, on a screen or on paper."""

import base64
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from importlib.resources import files

import pandas as pd
import plotly.graph_objects as go
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from annotate.scheme.scheme import Part
from eval.report.frame_images import ERROR_KINDS, Image, data_uri

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
class Head:
    """Title of a page, the text below it, and a text at its end; all are escaped."""

    title: str
    lead: str
    footer: str = ""


@dataclass(frozen=True)
class Section:
    """A section of the page, with its blocks in their order; every text is escaped.

    figures: by caption; without data, a figure is left out. legends: parts of the rows' images, by heading.
    """

    title: str
    lead: str
    notes: Sequence[str] = ()
    figures: Mapping[str, go.Figure] = field(default_factory=dict)
    tables: Sequence[tuple[str, pd.DataFrame]] = ()
    rows: Sequence[tuple[str, Mapping[str, Image]]] = ()
    legends: Mapping[str, Sequence[Part]] = field(default_factory=dict)
    facts: Mapping[str, str] = field(default_factory=dict)

    @property
    def drawn(self) -> dict[str, go.Figure]:
        """Figures with data."""
        return {caption: figure for caption, figure in self.figures.items() if figure.data}


def html_of(head: Head, sections: Iterable[Section]) -> str:
    """Return a page as HTML."""
    shown = {f"s{i}": section for i, section in enumerate(sections)}
    drawn = {
        f"{name}-{k}": figure
        for name, section in shown.items()
        for k, figure in enumerate(section.drawn.values())
    }
    script = _PAGES.loader.get_source(_PAGES, "page.js")[0]  # type: ignore[union-attr]
    plotly = PLOTLY.read_text()
    return _PAGES.get_template("page.html.j2").render(
        version=version("annotate-cloud"),
        policy=policy(plotly, script),
        head=head,
        sections=shown,
        errors=[kind for name, kind in ERROR_KINDS.items() if name != "background"],
        data=Markup(embedded(drawn)),
        plotly=Markup(plotly),
        script=Markup(script),
    )


def policy(*scripts: str) -> str:
    """Return the page's content security policy: only these scripts, its own pictures, no request."""
    hashes = (base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts)
    allowed = " ".join(f"'sha256-{value}'" for value in hashes)
    # Plotly makes a style sheet and draws its pictures from blobs of the page.
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def embedded(drawn: Mapping[str, go.Figure]) -> str:
    """Return the figures as JSON for a script element; no text of it is markup."""
    text = "{" + ",".join(f'"{name}":{figure.to_json()}' for name, figure in drawn.items()) + "}"
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
