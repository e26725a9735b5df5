"""Run the documentation's notebook and write its outputs: ``python -m tools.docs.notebook``."""

import ast
import base64
import io
import json
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from PIL import Image

NOTEBOOK = Path(__file__).parents[2] / "docs" / "notebooks" / "first-frames.ipynb"


def code_of(notebook: dict[str, Any]) -> list[str]:
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]


def run(cells: list[str]) -> list[tuple[str, Any]]:
    """Return the output of each cell and the value of its last expression, if any."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    shown = []
    for number, source in enumerate(cells, 1):
        tree = ast.parse(source)
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        said, value = io.StringIO(), None
        with redirect_stdout(said):
            exec(compile(tree, f"cell {number}", "exec"), namespace)
            if last is not None:
                value = eval(compile(ast.Expression(last.value), f"cell {number}", "eval"), namespace)
        shown.append((said.getvalue(), value))
    return shown


def outputs_of(said: str, value: Any, number: int) -> list[dict[str, Any]]:
    """Return a cell's output as a notebook stores it."""
    kept: list[dict[str, Any]] = []
    if said:
        kept.append({"output_type": "stream", "name": "stdout", "text": said.splitlines(keepends=True)})
    if value is not None:
        data = {"text/plain": [repr(value)]}
        if isinstance(value, Image.Image):
            png = io.BytesIO()
            value.save(png, "PNG", optimize=True)
            data = {"image/png": base64.b64encode(png.getvalue()).decode(), "text/plain": ["a picture"]}
        kept.append(
            {"output_type": "execute_result", "execution_count": number, "metadata": {}, "data": data}
        )
    return kept


def main() -> None:
    notebook = json.loads(NOTEBOOK.read_text())
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for number, (cell, shown) in enumerate(zip(cells, run(code_of(notebook)), strict=True), 1):
        cell["outputs"], cell["execution_count"] = outputs_of(*shown, number), number
    NOTEBOOK.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
