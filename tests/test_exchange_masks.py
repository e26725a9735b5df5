"""Masks as run lengths and polygons are exact, and hostile files of them are refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import tree
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.exchange import masks
from annotate.exchange.coco import ANNOTATIONS, rle_from_string, rle_to_string
from annotate.exchange.cvat import ANNOTATIONS as XML
from annotate.exchange.formats import export_labels, import_labels
from annotate.exchange.masks import mask_from_runs, runs_of
from annotate.labelset.label_set import LabelSet
from sensors.errors import CloudError, FormatError
from tests.helpers.label_sets import CAMERA, blocks, make

law = settings(deadline=None, max_examples=12)


def nothing(_: int) -> None:
    pass


@pytest.fixture
def labels(tmp_path) -> LabelSet:
    return make(tmp_path / "labels", CAMERA, [blocks(0), blocks(1)])


@pytest.fixture
def export(labels, tmp_path):
    def run(name: str) -> Path:
        out = tmp_path / name
        export_labels(labels, out, name, nothing)
        return out

    return run


BOMB = '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


def xml(shape: str, name: str = "000000.png") -> str:
    return f'<annotations><image name="{name}">{shape}</image></annotations>'


def mask(label: str, rle: str, left: int, width: int, height: int = 1) -> str:
    return xml(f'<mask label="{label}" rle="{rle}" left="{left}" top="0" width="{width}" height="{height}"/>')


EVIL_XML = {
    "empty dtd": "<!DOCTYPE x>" + xml(""),
    "bomb": BOMB + "]><annotations>&i;</annotations>",
    "external": '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/hostname">]>' + xml("", "&e;"),
    "external dtd": '<!DOCTYPE x SYSTEM "http://127.0.0.1:1/x.dtd"><annotations/>',
    "deep": "<a>" * 100_000,
    "cut": "<annotations><image",
    "other": "<html></html>",
    "nul": xml("", "a&#x41;.png"),
    "label": mask("tail", "0,1", 0, 1),
    "huge": mask("head", "0,999999999999", 0, 10**6, 10**6),
    "negative": mask("head", "-1,2", 0, 1),
    "nan": xml('<polygon label="head" points="nan,0;1,1;2,2"/>'),
}


@given(st.lists(st.booleans(), min_size=1, max_size=80), st.integers(0, 3))
@law
def test_run_lengths_are_those_of_pycocotools(bits, zeros):
    mask = pytest.importorskip("pycocotools.mask")
    flat = np.array([*bits, *[False] * (400 * zeros)], bool)
    runs = runs_of(flat)
    theirs = mask.encode(np.asfortranarray(flat[:, None].astype(np.uint8)))["counts"].decode()
    assert rle_to_string(runs) == theirs
    assert rle_from_string(theirs) == runs
    np.testing.assert_array_equal(mask_from_runs(runs, len(flat)), flat)


def test_cvat_masks_and_polygons_of_others_are_read(export, tmp_path):
    """Also of many corners and many masks; a name leads nowhere outside."""
    out = export("cvat")
    (out / XML).write_text(
        '<?xml version="1.0" encoding="utf-8"?><annotations><version>1.1</version>'
        '<image id="7" name="sub/000001.png" width="32" height="24">'
        '<polygon label="torso" points="4.0,3.0;10.0,3.0;10.0,9.0;4.0,9.0" z_order="0"></polygon>'
        '<mask label="head" rle="1, 2, 1" left="5" top="4" width="2" height="2" z_order="1"/>'
        '<box label="x" xtl="1"/><tag label="y"/></image></annotations>'
    )
    parts = import_labels(out, tmp_path / "back", nothing)[0].read("000001").parts
    assert parts[4:6, 5:7].tolist() == [[2, 1], [1, 2]]
    assert set(np.unique(parts[4:8, 5:9])) == {1, 2} and (parts > 0).sum() in range(36, 50)
    round_ = [(16 + 9 * np.cos(a), 12 + 9 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 12_000)]
    polygon = f'<polygon label="torso" points="{";".join(f"{x:.4f},{y:.4f}" for x, y in round_)}"/>'
    dot = '<mask label="head" rle="0,1" left="16" top="12" width="1" height="1" z_order="1"/>'
    (out / XML).write_text(xml(polygon + dot * 2500, "../../000000.png"))
    parts = import_labels(out, tmp_path / "many", nothing)[0].read("000000").parts
    assert parts[12, 16] == 1 and (parts == 2).sum() in range(230, 290)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize("name", EVIL_XML)
def test_evil_xml_is_refused(export, tmp_path, name, encoding):
    out = export("cvat")
    before = tree(tmp_path)
    (out / XML).write_bytes(EVIL_XML[name].encode(encoding))
    with pytest.raises(CloudError, match="document type" if "DOCTYPE" in EVIL_XML[name] else None) as error:
        import_labels(out, tmp_path / "back", nothing)
    assert "hostname" not in str(error.value).replace(str(tmp_path), "")
    assert set(tree(tmp_path)) == set(before)


def test_coco_with_uncompressed_runs_is_read_and_equal_names_are_refused(export, tmp_path):
    out = export("coco")
    content = json.loads((out / ANNOTATIONS).read_text())
    for annotation in content["annotations"]:
        annotation["segmentation"]["counts"] = rle_from_string(annotation["segmentation"]["counts"])
    (out / ANNOTATIONS).write_text(json.dumps(content))
    back, *_ = import_labels(out, tmp_path / "back", nothing)
    np.testing.assert_array_equal(back.read("000000").parts, blocks(0).parts)
    content["images"][1]["file_name"] = content["images"][0]["file_name"]
    (out / ANNOTATIONS).write_text(json.dumps(content))
    with pytest.raises(FormatError, match="two images are called"):
        import_labels(out, tmp_path / "more", nothing)


@pytest.mark.parametrize("seed", range(5))
def test_a_polygon_is_its_naive_twin(seed, monkeypatch):
    """Ray by ray (Shimrat 1962), however few edges are computed at once."""
    monkeypatch.setattr(masks, "CELLS", 3 * 30)
    corners = np.random.default_rng(seed).uniform(-10, 50, (9, 2))
    x, y = np.meshgrid(np.arange(40) + 0.5, np.arange(30) + 0.5)
    odd = np.zeros((30, 40), bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        odd ^= ((y0 <= y) != (y1 <= y)) & (x0 + (y - y0) * (x1 - x0) / (y1 - y0) <= x)
    np.testing.assert_array_equal(masks.polygon_pixels(corners, (30, 40)), odd)
