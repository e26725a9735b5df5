"""The page: complete, inert whatever the labels are called, and working in a real browser."""

import base64
import hashlib
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser

import cv2
import numpy as np
import plotly.graph_objects as go
import pytest

from eval.compare.compare import Comparison, compare_sets
from eval.compare.results import Result
from eval.report.build import render
from eval.report.gather import Material
from tests.helpers.browser import CHROMIUM, Browser
from tests.helpers.report_doll import HOSTILE, hostile_material, label_sets, trained


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Material:
    folder = tmp_path_factory.mktemp("page")
    sets = label_sets(folder)
    return hostile_material(sets, compare_sets(*sets), trained(folder / "compact"))


@pytest.fixture(scope="module")
def compared(material: Material) -> Comparison:
    return material.results[0].comparison


@pytest.fixture(scope="module")
def page(material: Material) -> str:
    return render(material)


class Page(HTMLParser):
    """Tags, their attributes, what stands in each script, and whether every tag is closed in order."""

    VOID = frozenset(("meta", "img", "br", "col", "input"))

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.scripts.append(data)


def test_no_text_becomes_markup(page: str) -> None:
    parsed = Page(page)
    tags = [tag for tag, _ in parsed.tags]
    assert not {"iframe", "object", "link", "base", "form", "embed"} & set(tags)
    assert tags.count("script") == len(parsed.scripts) == 3
    assert not [name for _, attributes in parsed.tags for name in attributes if name.startswith("on")]
    assert HOSTILE not in page and "<script>window" not in page and "&lt;script&gt;window" in page
    json.loads(parsed.scripts[0])


def test_only_the_page_s_own_scripts_may_run(page: str) -> None:
    parsed = Page(page)
    policy = next(a["content"] for tag, a in parsed.tags if a.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None and "default-src 'none'" in policy
    allowed = re.findall(r"'sha256-([^']+)'", policy.split("script-src")[1].split(";")[0])
    digests = [base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in parsed.scripts[1:]]
    assert allowed == digests
    script = policy.split("script-src")[1].split(";")[0]
    assert "unsafe" not in script and "http" not in policy


def test_the_page_loads_nothing(page: str) -> None:
    parsed = Page(page)
    for _, attributes in parsed.tags:
        for name in ("src", "href", "srcset", "data", "action", "xlink:href"):
            value = attributes.get(name)
            assert value is None or value.startswith(("data:image/", "#"))
    for script in parsed.scripts:
        page = page.replace(script, "")
    assert not re.search(r"url\(|@import|https?://", page)


def test_the_page_says_what_the_numbers_say(page: str, compared: Comparison) -> None:
    assert f"{compared.scores['mean_recall']:.3f}" in page
    assert "0.864" in page and "0.732" in page
    assert "6 frames of 3 people" in page and "2026-01-02 to 2026-01-03" in page
    rows, columns, shown, training = 6, 4, 6 * 3, 9
    assert [tag for tag, _ in Page(page).tags].count("img") == rows * columns + shown + training


def test_every_figure_is_one_that_plotly_knows(page: str) -> None:
    """Plotly's own validators refuse unknown properties and values; colours are the style sheet's names."""
    found = json.loads(Page(page).scripts[0])["figures"]
    assert {"overview", "parts-recall", "people", "reliability", "pck", "loss", "differences"} <= set(found)
    for value in found.values():
        go.Figure(json.loads(re.sub(r"var\(--\w+\)", "#123456", json.dumps(value))))
    style = page[: page.index("</style>")]
    for name in set(re.findall(r"var\((--\w+)\)", json.dumps(found))):
        assert f"{name}:" in style


def test_what_is_absent_is_left_out_and_said(compared: Comparison) -> None:
    """Nothing but background, no confidence: every score is absent, none is 0 or 1."""
    counts = compared.counts
    blank = type(counts)(np.zeros_like(counts.flat))
    blank.confusion[:, 0, 0] = 50
    page = render(Material((Result("Empty", replace(compared, counts=blank)),)))
    ids = [attributes.get("id") for tag, attributes in Page(page).tags if tag == "section"]
    assert "calibration" not in ids and "gallery" not in ids and {"headline", "parts", "method"} <= set(ids)
    assert "Left out" in page and "calibration (the labels came without confidence)" in page


@pytest.fixture(scope="module")
def browser(page: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("needs chromium")
    folder = tmp_path_factory.mktemp("browser")
    (folder / "report.html").write_text(page)
    found = Browser(folder / "profile")
    found.open(folder / "report.html")
    yield found
    found.close()


def test_a_browser_draws_every_figure(browser: Browser, page: str) -> None:
    wanted = len(json.loads(Page(page).scripts[0])["figures"])
    assert browser.run("document.querySelectorAll('[data-figure] .main-svg').length >= 1")
    assert browser.run("document.querySelectorAll('[data-figure].js-plotly-plot').length") == wanted
    drawn = cv2.imdecode(np.frombuffer(browser.picture(), np.uint8), cv2.IMREAD_COLOR)
    assert drawn.std() > 10
    assert browser.run("document.documentElement.scrollWidth <= innerWidth")


def test_names_from_files_are_shown_letter_by_letter(browser: Browser) -> None:
    assert browser.run("window.hit") is None
    assert browser.run("document.querySelectorAll('img:not([src^=\"data:image/\"])').length") == 0
    assert browser.run("document.querySelectorAll('svg a, svg image, svg foreignObject').length") == 0
    titles = browser.run("[...document.querySelectorAll('.hero h3')].map(e => e.textContent)")
    assert titles == ["Automatic", f"Network {HOSTILE}"]


def test_the_controls_work(browser: Browser) -> None:
    browser.run("document.querySelector('#headline table.sortable th:nth-child(2)').click()")
    cells = "[...document.querySelectorAll('#headline tbody td:nth-child(2)')]"
    column = f"{cells}.map(e => parseFloat(e.textContent))"
    values = browser.run(column)
    assert values == sorted(values)
    browser.run("document.querySelector('#headline table.sortable th:nth-child(2)').click()")
    assert browser.run(column) == values[::-1]
    change = "e.dispatchEvent(new Event('change', {bubbles: true}))"
    browser.run(f"(e => {{ e.value = '1'; {change} }})(document.querySelector('[data-by=part]'))")
    ious = browser.run(
        "[...document.querySelectorAll('#gallery figure:not([hidden]) .of-part')].map(e => e.textContent)"
    )
    numbers = [float(text.split()[-1]) for text in ious]
    assert len(numbers) == 6 and numbers == sorted(numbers)
    browser.run(f"(e => {{ e.value = ''; {change} }})(document.querySelector('[data-by=part]'))")
    search = "(e => { e.value = 'automatic'; e.dispatchEvent(new Event('input')) })"
    browser.run(f"{search}(document.querySelector('[data-filter]'))")
    assert (
        browser.run("[...document.querySelectorAll('#frame-table tbody tr')].filter(e => !e.hidden).length")
        == 6
    )
    before = browser.run("getComputedStyle(document.body).backgroundColor")
    browser.run("document.getElementById('theme').click()")
    assert browser.run("getComputedStyle(document.body).backgroundColor") != before


def waiting_for(condition: str) -> str:
    """A script that ends, with True, once the condition holds."""
    look = f"const look = () => {condition} ? done(true) : setTimeout(look, 50)"
    return f"new Promise(done => {{ {look}; look(); }})"


def test_the_cloud_turns_and_changes_colour(browser: Browser) -> None:
    browser.run("stage.scrollIntoView()")
    assert browser.run(waiting_for("stage.data"))
    offered = browser.run("[...document.getElementById('scene-color').options].map(e => e.value)")
    assert offered == ["truth", "predicted", "error"]
    change = "(e => { e.value = 'error'; e.dispatchEvent(new Event('change')) })"
    browser.run(f"{change}(document.getElementById('scene-color'))")
    assert "Correct" in browser.run("document.getElementById('scene-legend').textContent")
    browser.run("document.getElementById('scene-turn').click()")
    assert browser.run(waiting_for("stage.layout.scene.camera.eye.x > 0.01"))
    browser.run("document.getElementById('scene-turn').click()")


def test_it_prints(browser: Browser) -> None:
    assert browser.pdf().startswith(b"%PDF")


def test_no_request_left_the_page_and_nothing_was_refused(browser: Browser) -> None:
    """Last: over everything that the tests above did."""
    asked = [
        e["params"]["request"]["url"] for e in browser.events if e["method"] == "Network.requestWillBeSent"
    ]
    assert asked and all(url.startswith(("file:", "data:image/", "blob:")) for url in asked)
    assert sum(url.startswith("file:") for url in asked) == 1
    refused = [
        e["params"] for e in browser.events if e["method"] in ("Runtime.exceptionThrown", "Log.entryAdded")
    ]
    assert not [entry for entry in refused if entry.get("entry", {}).get("level") != "warning"]
