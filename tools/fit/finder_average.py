"""Average two person finders: python -m tools.fit.finder_average NEW.onnx OLD.onnx SHARE OUT.onnx.

SHARE: of the new weights, 0 to 1; the rest are the old ones, with which the new training began.
"""

import argparse
from pathlib import Path

from eval.training.finder.network import averaged_finder, export_finder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("new", "old"):
        parser.add_argument(name, type=Path)
    parser.add_argument("share", type=float)
    parser.add_argument("out", type=Path)
    given = parser.parse_args()
    export_finder(averaged_finder(given.new, given.old, given.share), given.out)


if __name__ == "__main__":
    main()
