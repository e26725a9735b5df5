"""The documentation site: Sphinx reads the Markdown beside this file, the command and the docstrings."""

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

project = "annotate-cloud"
author = "the annotate-cloud engineers"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.apidoc"]
html_theme = "furo"
html_title = "annotate-cloud"
exclude_patterns = ["_build"]
myst_heading_anchors = 3

# Docstrings are plain sentences: a word in backticks is code, whatever Sphinx would make of it.
default_role = "code"
autodoc_typehints = "description"
autodoc_member_order = "bysource"
apidoc_modules = [
    {
        "path": f"../{package}",
        "destination": f"api/{package}",
        "separate_modules": True,
        "module_first": True,
    }
    for package in ("sensors", "annotate", "synth", "eval")
]
suppress_warnings = ["ref.python", "docutils"]


def setup(app: object) -> None:
    """Write the command's reference from the command itself."""
    docs = ["-m", "typer", "cli.main", "utils", "docs", "--name", "annotate-cloud", "--title", "The command"]
    subprocess.run([sys.executable, *docs, "--output", str(HERE / "command.md")], check=True, cwd=HERE.parent)
