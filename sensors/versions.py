"""Versions of installed packages, and the digest of the code itself."""

import hashlib
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

CODE = frozenset({".py", ".toml", ".npz", ".json", ".onnx", ".safetensors", ".cpp"})


def different(here: dict[str, str], wanted: dict[str, str]) -> str:
    """Return the versions that differ, as text: name, own version, wanted version."""
    names = sorted(name for name in here.keys() | wanted.keys() if here.get(name) != wanted.get(name))
    return ", ".join(
        f"{name} {here.get(name, 'none')} instead of {wanted.get(name, 'none')}" for name in names
    )


def versions(packages: Iterable[str]) -> dict[str, str]:
    """Return the version of each package; "none" where it is not installed under this name."""
    found = {}
    for name in packages:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
    return found


@cache
def code_digest(*packages: str) -> str:
    """Return 16 hexadecimal digits of the SHA-256 of the packages' code and data.

    Compiled extensions are left out, because each machine compiles its own.
    """
    digest = hashlib.sha256()
    for package in packages:
        spec = find_spec(package)
        for folder in map(Path, (spec and spec.submodule_search_locations) or ()):
            for file in sorted(folder.rglob("*")):
                if file.suffix in CODE and "__pycache__" not in file.parts:
                    digest.update(f"{package}/{file.relative_to(folder)}\0".encode() + file.read_bytes())
    return digest.hexdigest()[:16]
