"""Choice of a bag's depth topic and colour topic, by their contents and names."""

import re
from collections.abc import Callable, Sequence
from enum import Enum
from typing import NamedTuple

from natsort import natsort_key

from sensors.errors import FormatError, Note, Setting
from sensors.importers.bags.ros_images import COLORS, DEPTHS, PICTURE_MAGICS, is_grey_png
from sensors.importers.bags.ros_messages import Picture


class Meaning(Enum):
    """Content of an image by its topic's name, such as depth or colour."""

    DEPTH = "depth"
    COLOR = "colour"
    OTHER = "other"
    UNKNOWN = "unknown"


_DEPTH, _COLOR = re.compile(r"depth"), re.compile(r"colou?r|rgb(?!d)|bgr")
_DERIVED = re.compile(
    r"confiden|uncertain|varian|disparit|mask|segment|semantic|instance|label|amplitude|intensity|reflect"
    r"|coloriz|colouris|colormap|heatmap|optical_?flow"
)  # made from depth, or about it
_SIXTEEN_BITS = re.compile(
    r"infra|therm|temperature|flir|boson|lepton|optris|(?<![a-z])seek|lwir|swir|fisheye"
    r"|(?<![a-z])n?ir\d?(?![a-z])"
)  # cameras of infrared light and of temperatures
_MEANINGS = [
    (_DERIVED, Meaning.OTHER),
    (_DEPTH, Meaning.DEPTH),
    (_COLOR, Meaning.COLOR),
    (_SIXTEEN_BITS, Meaning.OTHER),
]
_ALIGNED = re.compile(r"aligned|registered|to_color|to_colour|to_rgb")
"""Depth in the pixels of the colour camera, as realsense-ros, ROS's depth_image_proc and others name it."""
_TRANSPORTS = ("compressed", "compresseddepth")

Pictures = dict[str, Picture]
"""First message of every image topic, by topic."""


class Choice(NamedTuple):
    """Topics to read. notes: assumptions of the choice."""

    depth: str
    color: str | None
    notes: tuple[str, ...]


def meaning_of(name: str) -> Meaning:
    """Return the meaning of a topic's name, by the last part that has one."""
    for part in reversed(_parts(name)):
        for word, meaning in _MEANINGS:
            if word.search(part):
                return meaning
    return Meaning.UNKNOWN


def is_aligned(name: str) -> bool:
    """Return whether a topic's name marks its depth images as aligned with colour."""
    return bool(_ALIGNED.search(name.lower()))


def choose(first: Pictures, wanted: Sequence[str] = ()) -> Choice | None:
    """Return the depth topic and the colour topic of the same camera; None without depth.

    wanted: topics, or namespaces, among which to choose; a topic that is named in full is depth or colour by
    its encoding alone. Raises FormatError for a name that no topic has.
    """
    for name in wanted:
        if not any(_is_below(topic, name) for topic in first):
            remedy = f"give one of {', '.join(sorted(first)[:8])}" if first else "record an image topic"
            raise FormatError(f"the recording has no image topic {name!r}; {remedy}")
    depth = choose_depth(first, wanted)
    if depth is None:
        return None
    color = _choose_color(first, depth, wanted)
    notes = [f"depth from {depth}", f"colour from {color}" if color else "no colour images"]
    if meaning_of(depth) is not Meaning.DEPTH and depth not in wanted:
        notes.append(f"{depth} is not named depth: read as depth because it is {first[depth].encoding[:40]}")
    rivals = [n for n in sorted(first) if _is_depth(n, first[n]) and camera_of(n) != camera_of(depth)]
    if rivals and not wanted:
        notes.append(Note(f"other depth images: {', '.join(rivals[:8])}; else choose one", Setting.TOPIC))
    return Choice(depth, color, tuple(notes))


def choose_depth(first: Pictures, wanted: Sequence[str] = ()) -> str | None:
    """Return the depth topic.

    Preferred, in this order: a name that means depth, a camera with colour, unaligned, raw, rectified.
    """
    named = [n for n in first if n in wanted and holds_depth(first[n]) and not _shows_color(n, first[n])]
    below = [n for n in wanted if n not in first]
    found = named or [n for n, image in first.items() if _is_depth(n, image) and _allowed(n, below)]
    colors = [camera_of(n) for n, image in first.items() if _is_color(n, image)]
    shared = {n: max((_shared(camera_of(n), color) for color in colors), default=0) for n in found}
    most = max(shared.values(), default=0)
    return _best(
        found,
        lambda name: meaning_of(name) is Meaning.DEPTH,
        lambda name: shared[name] == most,
        lambda name: not is_aligned(name) and not _COLOR.search(first[name].frame_id.lower()),
        lambda name: not first[name].compressed,
        lambda name: "rect" in name.lower(),
    )


def _choose_color(first: Pictures, depth: str, wanted: Sequence[str]) -> str | None:
    """Return the colour topic, None if there is none.

    Preferred, in this order: a topic of the depth topic's camera, a name with "color" or "rgb", a name
    without "depth", JPEG or PNG rather than raw pixels.
    """
    camera = camera_of(depth)
    named = [n for n in first if n in wanted and n != depth and _shows_color(n, first[n])]
    below = [n for n in wanted if n not in first]
    colors = [n for n, image in first.items() if _is_color(n, image) and n != depth]
    found = named or [n for n in colors if _allowed(n, below)] or colors
    nearest = max((_shared(camera, camera_of(name)) for name in found), default=0)
    return _best(
        found,
        lambda name: _shared(camera, camera_of(name)) == nearest,
        lambda name: bool(_COLOR.search(name.lower())),
        lambda name: not _DEPTH.search(name.lower()),
        lambda name: first[name].compressed,
        lambda name: "rect" not in name.lower(),
    )


def camera_of(name: str) -> tuple[str, ...]:
    """Return the parts of a topic's name before the part with a meaning, which name the camera."""
    parts = _parts(name)
    meant = [at for at, part in enumerate(parts) if meaning_of(part) is not Meaning.UNKNOWN]
    return tuple(parts[: meant[-1]] if meant else parts[:-1])


def _parts(name: str) -> list[str]:
    """Return the parts of a name in small letters, without the transport."""
    parts = [part for part in name.lower().split("/") if part]
    return [part for part in parts if part not in _TRANSPORTS] or parts


def _shared(a: tuple[str, ...], b: tuple[str, ...]) -> int:
    """Return the number of parts that two names share from the beginning."""
    return next((at for at, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))


def _best(names: Sequence[str], *tests: Callable[[str], bool]) -> str | None:
    """Return the best topic, None without names. Earlier tests count more.

    Among equals, the shortest name wins, then the first in natural order.
    """
    return min(names, key=lambda n: (*(not test(n) for test in tests), len(n), natsort_key(n)), default=None)


def _is_below(topic: str, name: str) -> bool:
    return topic == name or topic.startswith(name.rstrip("/") + "/")


def _allowed(topic: str, wanted: Sequence[str]) -> bool:
    return not wanted or any(_is_below(topic, name) for name in wanted)


def holds_depth(image: Picture) -> bool:
    """Return whether the encoding can be depth."""
    if image.compressed:
        return "compressedDepth" in image.encoding or is_grey_png(image)
    return image.encoding in DEPTHS


def _is_depth(name: str, image: Picture) -> bool:
    """Return whether a topic is depth. Images of 16 bits with another name may be infrared or temperatures.

    Where the name has no meaning, ROS's encodings of depth count (REP 118; not ``mono16``), unless the
    camera's frame has the name of another camera.
    """
    if not holds_depth(image):
        return False
    meaning = meaning_of(name)
    if meaning is not Meaning.UNKNOWN:
        # iai_kinect2 and others put the words for both into one part, e.g. depth_to_rgb.
        return meaning is Meaning.DEPTH
    return "mono16" not in image.encoding and meaning_of(image.frame_id) is not Meaning.OTHER


def _shows_color(name: str, image: Picture) -> bool:
    """Return whether the encoding can be colour."""
    if not image.compressed:
        # Depth of 8 bits is a picture of depth.
        grey = image.encoding in ("mono8", "8UC1")
        return image.encoding in COLORS and not (grey and meaning_of(name) is Meaning.DEPTH)
    picture = image.data.startswith(PICTURE_MAGICS) and not is_grey_png(image)
    return picture and (meaning_of(name) is not Meaning.DEPTH or image.encoding.startswith(("rgb", "bgr")))


def _is_color(name: str, image: Picture) -> bool:
    return meaning_of(name) is not Meaning.OTHER and _shows_color(name, image)
