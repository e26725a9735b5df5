"""Write the report: one HTML file that opens offline, on a screen or on paper, and tables beside it."""

import base64
import hashlib
import json
from collections.abc import Sequence
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from numpy.typing import NDArray

from annotate.parts import PARTS, UNDEFINED
from eval.compare import paper_results as paper
from eval.compare.details import suspicious
from eval.report import plots, tables
from eval.report.estimates import SHARES, SHOWN_ORDER, SUMMARY, difference_of, estimate, shown, verdict
from eval.report.frame_images import ERROR_NAMES, ERROR_RGB, THERMAL_RANGE_C, data_uri
from eval.report.gallery import Scene
from eval.report.gather import Material
from eval.report.views import PART_SCORES, group_tables, joints_of, view_of
from eval.scores import confusion
from sensors.errors import CloudError
from sensors.files.atomic import check_free, write_bytes

TITLE = "Body-part labels: comparison report"
PLOTLY = files("plotly").joinpath("package_data", "plotly.min.js")
TEMPLATES = Path(str(files("eval.report").joinpath("templates")))
SCRIPTS = ("theme", "figures", "tables", "gallery", "scenes")
SUSPECTS = 30
"""Doubtful labels listed at most; chosen by eye."""

SECTIONS = {
    "headline": ("Headline", ""),
    "gap": ("Domain gap", ""),
    "parts": ("Parts", ""),
    "differences": ("One against the other", "differences (one result only)"),
    "confusion": ("Confusion", ""),
    "errors": ("Errors", ""),
    "calibration": ("Calibration", "calibration (the labels came without confidence)"),
    "joints": ("Joints", "joints (the truth knows none)"),
    "people": ("People", ""),
    "gallery": ("Gallery", "frames to look at (their label sets were not found)"),
    "scenes": ("3D", "a 3D view (the label sets were not found)"),
    "shown": ("Without a truth", "frames without a truth (--shown)"),
    "training": ("Training", "training curves (--history)"),
    "audit": ("Corrections", "corrections (--audit)"),
    "method": ("Method and sources", ""),
}
"""Sections in the order of the page: names in its contents, and what is missing where one is left out."""

SURROUNDINGS_RGB = (84, 86, 94)
"""In a cloud what is no person is grey, where a picture's background is nearly black; chosen by eye."""

UNDEFINED_RGB = (150, 140, 120)

_KINDS = {"int16": "i2", "uint8": "u1", "float32": "f4"}

# Names, ids and subjects come from label files: everything is escaped.
_PAGE = Environment(
    loader=FileSystemLoader(TEMPLATES),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_PAGE.filters["picture"] = data_uri
_PAGE.globals |= {
    "parts": [PARTS[i] for i in SHOWN_ORDER],
    "all_parts": PARTS,
    "summary": SUMMARY,
    "part_scores": PART_SCORES,
    "shares": SHARES,
    "error_kinds": list(zip(ERROR_NAMES[1:], ERROR_RGB[1:], strict=True)),
    "paper": paper,
    "measures": confusion,
    "estimate": estimate,
    "difference_of": difference_of,
    "ordered": shown,
    "verdict": verdict,
}


def write_report(path: Path, material: Material, overwrite: bool = False) -> list[Path]:
    """Write the page, and its numbers as .csv, .json and .tex beside it; returns all files, the page last.

    Raises ExistsError when one of them is there and `overwrite` is not set: then none is written.
    """
    outputs = free_outputs(path, overwrite)
    texts = [*tables.texts(material).values(), render(material)]
    path.parent.mkdir(parents=True, exist_ok=True)
    for file, text in zip(outputs, texts, strict=True):
        # Names, subjects and notes may hold half a surrogate pair, which no file of text can.
        write_bytes(file, text.encode(errors="replace"))
    return outputs


def free_outputs(path: Path, overwrite: bool) -> list[Path]:
    """The files that `write_report` makes of a page's path, the page last: to be checked before long work.

    Raises ExistsError when one is there and `overwrite` is not set, CloudError for a name that is a table's.
    """
    if path.suffix in tables.SUFFIXES:
        raise CloudError(f"{path} has the suffix of a table; give a name that ends in .html")
    outputs = [*(path.with_suffix(suffix) for suffix in tables.SUFFIXES), path]
    for file in outputs:
        check_free(file, overwrite)
    return outputs


def render(material: Material) -> str:
    """The page as a string: no clock and no chance, the same material gives the same bytes."""
    numbers = _numbers(material)
    contents = {name: title for name, (title, _) in SECTIONS.items() if numbers.get(name, True)}
    script = "\n".join((TEMPLATES / "scripts" / f"{name}.js").read_text() for name in SCRIPTS)
    plotly = PLOTLY.read_text()
    return _PAGE.get_template("report.html.j2").render(
        title=TITLE,
        version=version("annotate-cloud"),
        policy=policy(plotly, script),
        plotly=Markup(plotly),
        script=Markup(script),
        data=Markup(embedded_json({"figures": numbers["figures"], **scene_json(material.scenes)})),
        contents=contents,
        absent=[why for name, (_, why) in SECTIONS.items() if why and name not in contents],
        **numbers,
    )


def policy(*scripts: str) -> str:
    """The page's content policy: these scripts and no other, pictures within the page, no request at all."""
    hashes = (base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts)
    allowed = " ".join(f"'sha256-{value}'" for value in hashes)
    # Plotly makes a style sheet of its own and draws its pictures from blobs of the page.
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def _numbers(material: Material) -> dict[str, Any]:
    """Values of the templates; a section's own name is true where it has content."""
    results, found = material.results, material.differences
    suspects = ((r.title, one) for r in results for one in suspicious(r.comparison, SUSPECTS))
    joints = [view for view in map(joints_of, results) if view is not None]
    galleries = {title: frames for title, frames in material.galleries.items() if frames}
    frames = [frame for shown_frames in galleries.values() for frame in shown_frames]
    tables_of_groups = group_tables(results)
    return {
        "views": material.views,
        "figures": plots.figures_of(material, joints),
        "ceiling": view_of(material.ceiling) if material.ceiling else None,
        "facts": material.facts,
        "differences": found,
        "group_tables": tables_of_groups,
        "gap": bool(found or tables_of_groups),
        "calibration": any(result.comparison.has_confidence for result in results),
        "suspects": sorted(suspects, key=lambda pair: pair[1].quality)[:SUSPECTS],
        "joints": joints,
        "galleries": galleries,
        "gallery": bool(galleries),
        "gallery_groups": list(dict.fromkeys(frame.group for frame in frames if frame.group)),
        "gallery_subjects": sorted({frame.subject for frame in frames if frame.subject}),
        "scenes": material.scenes,
        "shown_sets": material.shown,
        "shown": bool(material.shown),
        "trainings": material.trainings,
        "training": bool(material.trainings),
        "audits": material.audits,
        "audit": any(audit.people for audit in material.audits.values()),
    }


def embedded_json(value: object) -> str:
    """JSON for a script element: `<`, `>` and `&` are escaped, so that no text of it is markup."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def packed(values: NDArray[np.generic]) -> dict[str, str]:
    """An int16, uint8 or float32 array as little-endian base64, as plotly writes them: dtype, bdata."""
    data = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()
    return {"dtype": _KINDS[values.dtype.name], "bdata": base64.b64encode(data).decode()}


def scene_json(scenes: Sequence[Scene]) -> dict[str, Any]:
    """Scenes, and names and colours of the ids in them."""
    parts = {"names": ["Surroundings"] * 256, "colors": [_css(SURROUNDINGS_RGB)] * 256}
    for part in PARTS[1:]:
        parts["names"][part.id], parts["colors"][part.id] = part.title, _css(part.rgb)
    parts["names"][UNDEFINED], parts["colors"][UNDEFINED] = "Undefined", _css(UNDEFINED_RGB)
    errors = {"names": list(ERROR_NAMES), "colors": [_css(rgb) for rgb in ERROR_RGB]}
    errors["colors"][0] = _css(SURROUNDINGS_RGB)
    return {
        "scenes": [
            {
                "points_mm": packed(scene.points_mm),
                "colors": {name: packed(values) for name, values in scene.colors.items()},
            }
            for scene in scenes
        ],
        "palettes": {"truth": parts, "predicted": parts, "error": errors},
        "temperature": THERMAL_RANGE_C,
    }


def _css(rgb: tuple[int, int, int]) -> str:
    return "rgb({},{},{})".format(*rgb)
