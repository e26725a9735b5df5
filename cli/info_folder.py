"""``info`` and ``validate`` of a folder of recordings: a row, or a list of problems, for each."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from cli.console import cell, facts, table
from sensors.errors import CloudError
from sensors.files.natural_order import paths_in_order
from sensors.importers.open_source import open_source


def recordings_in(folder: Path) -> list[Path]:
    """Return the MCAP files of a folder with sessions.

    The list is empty where the folder is a recording itself, or has no sessions.
    """
    if not folder.is_dir() or (folder / "metadata.yaml").exists() or (folder / "depth").exists():
        return []
    from sensors.session.recognise import mcap_files

    sessions, foreign, unknown = mcap_files(folder)
    return paths_in_order([*sessions, *foreign, *unknown]) if sessions else []


def folder_info(files: list[Path]) -> tuple[dict[str, Any], str]:
    """Return the contents of a folder's recordings, as JSON, and as lines for people."""
    found: dict[str, dict[str, Any]] = {}
    for file in files:
        try:
            source = open_source(file)
            span_s = float(source.times_ns[-1] - source.times_ns[0]) * 1e-9 if len(source) else 0.0
            found[file.name] = {
                "kind": type(source).__name__,
                "name": source.name,
                "frames": len(source),
                "duration_s": round(span_s, 3),
                "notes": list(source.notes),
            }
        except (CloudError, OSError) as error:
            found[file.name] = {"error": str(error)}
    rows = [
        (name, one["kind"], one["name"], one["frames"], cell(one["duration_s"], "s"))
        for name, one in found.items()
        if "error" not in one
    ]
    lines = [f"{name}: {text}" for name, one in found.items() for text in _texts(one)]
    head = facts({"kind": "folder of recordings", "recordings": len(files)})
    result = {"kind": "folder of recordings", "recordings": found}
    columns = ("file", "kind", "name", "frames", "duration")
    return result, "\n\n".join([head, table(columns, rows), *lines])


def folder_problems(
    files: list[Path], problems_of: Callable[[Path], tuple[list[str], list[str]]]
) -> tuple[list[str], list[str]]:
    """Return the problems and doubts of every recording of a folder, each with its file's name."""
    problems: list[str] = []
    doubts: list[str] = []
    for file in files:
        try:
            wrong, doubtful = problems_of(file)
        except (CloudError, OSError) as error:
            wrong, doubtful = [str(error)], []
        problems += [f"{file.name}: {problem}" for problem in wrong]
        doubts += [f"{file.name}: {doubt}" for doubt in doubtful]
    return problems, doubts


def _texts(one: dict[str, Any]) -> list[str]:
    return [one["error"]] if "error" in one else one["notes"]
