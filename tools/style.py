"""Check the words and shapes of the tree: ``python -m tools.style [PATH ...]``; exit 1 on any fault."""

import ast
import io
import re
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

MAX_WORDS = 25
"""Words in a sentence of a docstring or a page."""
MAX_CELL_WORDS = 20
"""Words in a cell of a page's table."""
MAX_PARAMETERS = 5
"""Parameters of a function other than a command's verb and a test."""
MAX_LINES = 350
"""Lines in a Python file."""
MAX_FILES = 15
"""Python files in a folder, without its ``__init__.py``."""
BANNED = """
    but for|chosen by eye|(?:is|are) told|tells? (?:it|them|apart)|told apart|for lack of|the very
    some ?body|no ?body|who ?ever|of whom|(?:is|are) no(?! longer| more)|(?:is|are) asked|asked twice
    glances?|complaints?|complains?|believes?|wish(?:ed|es)? for|makes nothing of|none for none|kin to
    those of|that of|what is|lest|the more so|to be had
"""
"""Phrases that a reader has to decode."""
BANNED_WORDS = re.compile(r"\b(" + "|".join(map(str.strip, BANNED.split("\n")[1:-1])) + r")\b", re.I)
RELATIVE = re.compile(r"(what|who|whose|which|where|whether|how|that|those|whoever)\b", re.I)
"""First words of a docstring that stand for a missing noun."""
PYTHON_FOLDERS_APART = {"tests"}
"""Folders whose files have flat names by decision (docs/adr/0001)."""


def tracked(paths: list[str]) -> list[Path]:
    """Return the tracked files under ``paths``, or all; their current text is checked, committed or not."""
    listed = subprocess.run(
        ["git", "ls-files", "--", *paths], capture_output=True, text=True, check=True
    ).stdout
    return [path for path in map(Path, listed.splitlines()) if path.exists()]


def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of prose; code spans count as one word, links as their text."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"``[^`]*``|`[^`]*`", "code", text)
    for block in re.split(r"\n\s*\n|::\n", text):
        yield from re.split(r"[.!?:;]+(?:\s|$)|\n\s*(?:[-*]|\d+\.) ", block)


def prose_faults(text: str) -> Iterator[str]:
    """Yield the banned phrases and long sentences of ``text``."""
    for found in BANNED_WORDS.finditer(re.sub(r"`[^`]*`", "code", text)):
        yield f"banned: {found[0]}"
    for sentence in sentences(text):
        count = len(re.findall(r"[\w'/-]+", sentence))
        if count > MAX_WORDS:
            yield f"{count} words: {' '.join(sentence.split())[:60]} ..."


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and text of every docstring, constants' included."""
    for node in ast.walk(tree):
        body = getattr(node, "body", [])
        for statement in body if isinstance(body, list) else []:
            match statement:
                case ast.Expr(ast.Constant(str(text))):
                    yield statement.lineno, text


def is_command(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Return whether a function's parameters are a verb's options or a test's fixtures."""
    annotations = [ast.unparse(a.annotation) for a in function.args.args if a.annotation]
    return function.name.startswith("test_") or any("Annotated" in text for text in annotations)


def shape_faults(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield functions with too many parameters."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) or is_command(node):
            continue
        names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
        count = len([name for name in names if name not in ("self", "cls")])
        if count > MAX_PARAMETERS:
            yield node.lineno, f"{node.name} has {count} parameters"


def python_faults(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and fault of a Python file."""
    text = path.read_text()
    tree = ast.parse(text)
    if (lines := text.count("\n")) > MAX_LINES:
        yield 1, f"{lines} lines"
    yield from shape_faults(tree)
    texts = list(docstrings(tree))
    for line, docstring in texts:
        yield from ((line, fault) for fault in prose_faults(docstring))
        if RELATIVE.match(docstring.strip()):
            yield line, f"starts with a pronoun: {docstring.strip()[:50]}"
    comments = tokenize.generate_tokens(io.StringIO(text).readline)
    words = [(token.start[0], token.string) for token in comments if token.type == tokenize.COMMENT]
    read = {docstring for _, docstring in texts}
    for node in ast.walk(tree):
        match node:
            case ast.Constant(str(message)) if " " in message and message not in read:
                words.append((node.lineno, message))
    for line, message in words:
        yield from ((line, f"banned: {found[0]}") for found in BANNED_WORDS.finditer(message))


def page_faults(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and fault of a Markdown page."""
    text = re.sub(r"```.*?```", lambda code: "\n" * code[0].count("\n"), path.read_text(), flags=re.DOTALL)
    prose = []
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("|"):
            for cell in line.strip().strip("|").split("|"):
                count = len(re.findall(r"[\w'/-]+", re.sub(r"`[^`]*`", "code", cell)))
                if count > MAX_CELL_WORDS:
                    yield number, f"cell of {count} words: {cell.strip()[:50]} ..."
            plain = re.sub(r"`[^`]*`", "", line)
            yield from ((number, f"banned: {found[0]}") for found in BANNED_WORDS.finditer(plain))
            line = ""
        prose.append("" if line.startswith("#") else line)
    joined = "\n".join(prose)
    for block in re.finditer(r"(?:.+\n?)+", joined):
        line_number = 1 + joined.count("\n", 0, block.start())
        yield from ((line_number, fault) for fault in prose_faults(block[0]))


def main() -> None:
    """Print every fault with its place."""
    files = [path for path in tracked(sys.argv[1:]) if path != Path("tools/style.py")]
    found = 0
    for path in files:
        check = {".py": python_faults, ".md": page_faults}.get(path.suffix)
        for line, fault in check(path) if check else ():
            print(f"{path}:{line}: {fault}")
            found += 1
    folders = Counter(path.parent for path in files if path.suffix == ".py" and path.name != "__init__.py")
    for folder, count in folders.items():
        if count > MAX_FILES and folder.parts[0] not in PYTHON_FOLDERS_APART:
            print(f"{folder}: {count} files")
            found += 1
    sys.exit(f"{found} faults" if found else 0)


if __name__ == "__main__":
    main()
