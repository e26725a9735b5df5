"""Measuring tools and benchmarks: imports."""

import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
ALONE = {"tools.fuzz.run"}
"""Needs its own process and an extra, because it instruments later imports."""
PATHS = [path.relative_to(ROOT) for folder in ("tools", "bench") for path in (ROOT / folder).rglob("*.py")]
MODULES = sorted({".".join(path.with_suffix("").parts) for path in PATHS} - ALONE)


@pytest.mark.parametrize("name", MODULES)
def test_a_tool_can_be_imported_and_shows_how_it_is_run(name):
    module = importlib.import_module(name)
    runs = "__main__" in Path(module.__file__).read_text()
    assert runs == (f"python -m {name}" in module.__doc__)
