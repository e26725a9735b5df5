"""Versions of packages and the digest of the code tell runs of other bytes apart."""

import sys

import pytest

from sensors.versions import code_digest, versions
from synth.images.generate import Order
from synth.images.presets import PRESETS


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package that can be imported, of one module and one table."""
    folder = tmp_path / "somebodys"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "table.toml").write_text("x = 1\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    code_digest.cache_clear()
    yield folder
    code_digest.cache_clear()


def digest() -> str:
    code_digest.cache_clear()
    return code_digest("somebodys")


def test_another_line_of_code_or_data_is_another_digest(package):
    first = digest()
    (package / "table.toml").write_text("x = 2\n")
    second = digest()
    (package / "more.py").write_text("")
    assert len({first, second, digest()}) == 3


def test_what_machines_make_themselves_is_no_part_of_it(package):
    first = digest()
    (package / "__pycache__").mkdir()
    (package / "__pycache__" / "table.py").write_text("1")
    (package / "_compiled.so").write_text("1")
    assert digest() == first


def test_a_package_that_is_absent_has_no_version():
    found = versions(["numpy", "opencv-of-another-name"])
    assert found["opencv-of-another-name"] == "none" != found["numpy"]


def test_a_dataset_of_other_code_is_another_one():
    order = Order(PRESETS["sitting-test"], 2, 0)
    assert order.manifest()["versions"]["code"] == code_digest("sensors", "annotate", "synth")
