"""The example notebook runs, and keeps no more than a page should weigh."""

import json

from PIL import Image

from tools.docs.notebook import NOTEBOOK, code_of, run


def test_the_notebook_runs_and_correcting_helps():
    notebook = json.loads(NOTEBOOK.read_text())
    shown = run(code_of(notebook))
    assert sum(isinstance(value, Image.Image) for _, value in shown) >= 2
    before, after = (value for _, value in shown if isinstance(value, float))
    assert 0.5 < before < after <= 1


def test_the_notebook_is_small_and_was_run_from_top_to_bottom():
    notebook = json.loads(NOTEBOOK.read_text())
    assert NOTEBOOK.stat().st_size < 300_000
    counts = [cell["execution_count"] for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert counts == list(range(1, len(counts) + 1))
    assert notebook["nbformat"] == 4
    assert "/" not in json.dumps(notebook["metadata"])
