"""Which topics of somebody else's recording are depth and colour: by their first message and their names."""

import re
from collections.abc import Callable

from sensors.importers.ros_images import COLORS, DEPTHS
from sensors.importers.ros_messages import Picture

_OTHERS = re.compile(
    r"infra|thermal|confidence|mask|segment|label|fisheye|amplitude|(?<![a-z])ir\d?(?![a-z])"
)
"""Names of 16-bit or 8-bit images that are neither depth nor colour."""


def choose_depth(first: dict[str, Picture]) -> str | None:
    """The depth topic: one called so rather than not, the sensor's own pixels before resampled ones, raw
    before compressed. first: the first message of every image topic."""
    return _best(first, _is_depth, ("depth", "!aligned|registered|to_color|to_rgb", "!compressed", "rect"))


def choose_color(first: dict[str, Picture]) -> str | None:
    """The colour topic: one called so rather than not, and the camera's own JPEG before decoded pixels."""
    return _best(first, _is_color, ("color|colour|rgb", "!depth", "compressed", "!rect"))


def described_by(picture: str, cameras: set[str]) -> str | None:
    """The topic that describes an image topic's camera: beside it, or beside what it was made from."""
    parent = picture
    while "/" in parent:
        parent = parent.rpartition("/")[0]
        for name in ("camera_info", "calibration", "info"):
            if f"{parent}/{name}" in cameras:
                return f"{parent}/{name}"
    return next(iter(cameras)) if len(cameras) == 1 else None


def _best(
    first: dict[str, Picture], fits: Callable[[str, Picture], bool], wishes: tuple[str, ...]
) -> str | None:
    """Of the topics that fit, the one with the earliest wishes fulfilled; then the shortest, then by name."""

    def rank(name: str) -> tuple[object, ...]:
        met = [bool(re.search(wish.lstrip("!"), name.lower())) != wish.startswith("!") for wish in wishes]
        return (*(not wish for wish in met), len(name), name)

    return min((name for name, image in first.items() if fits(name, image)), key=rank, default=None)


def _is_depth(name: str, image: Picture) -> bool:
    if image.compressed:
        return "compressedDepth" in image.encoding
    return image.encoding in DEPTHS and not _OTHERS.search(name.lower())


def _is_color(name: str, image: Picture) -> bool:
    if _OTHERS.search(name.lower()):
        return False
    if image.compressed:
        return image.data.startswith((b"\xff\xd8\xff", b"\x89PNG")) and "depth" not in name.lower()
    return image.encoding in COLORS
