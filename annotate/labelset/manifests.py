"""Names of the files that say what a folder holds, without the imports of what reads them."""

LABELSET = "labelset.json"
DATASET = "dataset.json"
