"""Files of garments: where they are, without reading them."""

from pathlib import Path

from sensors.errors import CloudError


def garment_files(folder: Path) -> list[Path]:
    """All ``.mhclo`` files of a folder and its subfolders, by path. Raises CloudError where there is none."""
    paths = sorted(folder.rglob("*.mhclo"))
    if not paths:
        raise CloudError(f"{folder} holds no .mhclo garment; give a folder of MakeHuman's clothes")
    return paths
