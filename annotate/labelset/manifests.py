"""Names of the files that say what a folder holds, without the imports of what reads them."""

from pathlib import Path

from sensors.files.natural_order import paths_in_order

LABELSET = "labelset.json"
DATASET = "dataset.json"


def label_sets_in(folder: Path) -> list[Path]:
    """Return the label sets directly inside a folder, as ``label`` and ``predict`` of a folder write them."""
    return paths_in_order(manifest.parent for manifest in folder.glob(f"*/{LABELSET}"))
