"""The order of numbered files: as people count, 2 before 10."""

import re
from decimal import Decimal

_NUMBER = re.compile(r"([0-9]+(?:\.[0-9]+)?)")


def counted(name: str) -> tuple[object, ...]:
    """Key that sorts names by the numbers in them, seconds with decimals too: "frame2" before "frame10"."""
    pieces = _NUMBER.split(name)
    # Texts and numbers take turns, so that like is compared with like.
    return (*(Decimal(piece) if at % 2 else piece for at, piece in enumerate(pieces)), name)
