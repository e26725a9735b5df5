"""CVAT for images 1.1: ``annotations.xml`` with run-length masks, and the depth images in ``images/``.

Format: CVAT's documentation, "CVAT for image"; a mask's runs go row by row within its box, zeros first.
Polygons are read as well (a pixel belongs to one when its centre lies in it); masks are exact.
XML with a document type, which is what entities and external references need, is refused.
"""

from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import NoReturn
from xml.etree.ElementTree import ParseError, XMLParser

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.crop import window_of
from annotate.exchange.companion import Companion, load_companion
from annotate.exchange.masks import (
    MASK_IDS,
    PERSON_NAME,
    Mask,
    check_masks,
    images_from,
    mask_from_runs,
    masks_of,
    runs_of,
)
from annotate.frame_labels import FrameLabels
from annotate.labelset.images import decode_depth, encode_depth
from annotate.parts import PARTS, UNDEFINED, palette_rgb
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

ANNOTATIONS, IMAGES = "annotations.xml", "images"
MAX_XML_BYTES = 1_000_000_000
"""A frame of a depth camera takes 10 kB: a hundred thousand of them as much."""
MAX_ATTRIBUTES = 15_000_000
"""Of elements, and elements: some 130 bytes of memory each. A frame of eleven parts and a person has 117."""
MAX_DEPTH = 10
"""Elements within each other; CVAT's own have six."""
MAX_POINTS = 10_000
"""Corners of a polygon; a person's outline has some hundreds."""
MAX_CROSSINGS, MAX_CROSSINGS_AN_IMAGE = 1 << 24, 1 << 27
"""Corners times rows: OpenCV looks at each edge on each row, and takes a second for those of one polygon."""
SHAPES = ("mask", "polygon")


def write_cvat(frames: Iterator[FrameLabels], companion: Companion, out: Path) -> None:
    """Write into an empty folder."""
    (out / IMAGES).mkdir()
    with (out / ANNOTATIONS).open("w", encoding="ascii") as xml:
        xml.write('<?xml version="1.0" encoding="utf-8"?>\n<annotations>\n <version>1.1</version>\n')
        xml.write(f" <meta><task><labels>{''.join(_labels())}</labels></task></meta>\n")
        for number, frame in enumerate(frames):
            name = f"{frame.frame_id}.png"
            (out / IMAGES / name).write_bytes(encode_depth(frame.depth_mm))
            height, width = frame.parts.shape
            xml.write(f' <image id="{number}" name="{name}" width="{width}" height="{height}">\n')
            xml.writelines(map(_mask_xml, masks_of(frame)))
            xml.write(" </image>\n")
            companion.add(frame)
        xml.write("</annotations>\n")


def is_cvat(source: Path) -> bool:
    """Whether a folder holds an ``annotations.xml``."""
    return (source / ANNOTATIONS).is_file()


def read_cvat(source: Path) -> tuple[Companion, Iterator[FrameLabels]]:
    """The inverse of ``write_cvat``. Raises FormatError, CalibrationError."""
    companion = load_companion(source)
    images = _parse(source / ANNOTATIONS)
    return companion, (_frame(source, image, companion) for image in images)


@dataclass
class _Image:
    """One image's attributes, and its shapes: (element's name, its attributes)."""

    fields: dict[str, str]
    shapes: list[tuple[str, dict[str, str]]] = field(default_factory=list)


class _Target:
    """What the XML parser calls: keeps images and shapes, passes everything else by."""

    def __init__(self) -> None:
        self.images: list[_Image] = []
        self._depth = 0
        self._attribute = ""

    def start(self, tag: str, fields: dict[str, str]) -> None:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise FormatError(f"{ANNOTATIONS} nests {self._depth} elements; export it again")
        if tag == "image":
            self.images.append(_Image(fields))
        elif self.images and tag in SHAPES:
            self.images[-1].shapes.append((tag, fields))
        elif self.images and tag == "attribute" and self.images[-1].shapes:
            self._attribute = fields.get("name", "")

    def data(self, text: str) -> None:
        if self._attribute == "number" and text.strip():
            self.images[-1].shapes[-1][1].setdefault("person", text.strip())

    def end(self, tag: str) -> None:
        self._depth -= 1
        self._attribute = ""

    def doctype(self, *_: str | None) -> NoReturn:
        raise FormatError(f"{ANNOTATIONS} has a document type, which is not read; export it from CVAT again")

    def close(self) -> None:
        pass


def _parse(file: Path) -> list[_Image]:
    target = _Target()
    data = read_bounded(file, MAX_XML_BYTES)
    if data.count(b"<") > MAX_ATTRIBUTES or data.count(b"=") > MAX_ATTRIBUTES:
        raise FormatError(f"{file} holds more than {MAX_ATTRIBUTES} attributes; export it in parts")
    # Not the encoding that the file names: in some of them these signs are other bytes.
    encoding = "utf-16" if data[:2] in (BOM_UTF16_LE, BOM_UTF16_BE) else "utf-8"
    parser = XMLParser(target=target, encoding=encoding)
    try:
        parser.feed(data)
        parser.close()
    except (ParseError, ValueError, LookupError) as error:
        raise FormatError(f"{file} is not XML ({str(error)[:80]}); export it from CVAT again") from error
    if not target.images:
        raise FormatError(f"{file} holds no image; give CVAT's 'CVAT for images 1.1'")
    return target.images


def _labels() -> Iterator[str]:
    colors = palette_rgb()
    for name, part in {**MASK_IDS, PERSON_NAME: UNDEFINED}.items():
        color = "#{:02x}{:02x}{:02x}".format(*(PARTS[part].rgb if part < len(PARTS) else colors[part]))
        number = "<attribute><name>number</name><mutable>False</mutable><input_type>number</input_type>"
        number += "<default_value>1</default_value><values>1\n255\n1</values></attribute>"
        attributes = number if name == PERSON_NAME else ""
        yield f"<label><name>{name}</name><color>{color}</color><type>mask</type>"
        yield f"<attributes>{attributes}</attributes></label>"


def _mask_xml(mask: Mask) -> str:
    rows, columns = window_of(mask.pixels)
    box = mask.pixels[rows, columns]
    rle = ", ".join(map(str, runs_of(box.ravel())))
    # Persons lie below the parts, or they would hide them.
    order = 0 if mask.name == PERSON_NAME else 1
    attribute = f'<attribute name="number">{mask.person}</attribute>' if mask.name == PERSON_NAME else ""
    place = f'left="{columns.start}" top="{rows.start}" width="{box.shape[1]}" height="{box.shape[0]}"'
    head = f'<mask label="{mask.name}" source="auto" occluded="0" rle="{rle}" {place} z_order="{order}">'
    return f"  {head}{attribute}</mask>\n"


def _frame(source: Path, image: _Image, companion: Companion) -> FrameLabels:
    name = PurePosixPath(image.fields.get("name", "").replace("\\", "/")).name
    try:
        depth_mm = decode_depth(read_bounded(source / IMAGES / name))
        check_masks(len(image.shapes), depth_mm.shape)
        corners = [_corners(fields["points"]) for kind, fields in image.shapes if kind == "polygon"]
        if max(corners, default=0) > MAX_POINTS or not _drawable(corners, depth_mm.shape[0]):
            raise FormatError(f"polygons of {max(corners)} corners on {depth_mm.shape[0]} rows; export masks")
        ordered = sorted(image.shapes, key=lambda shape: int(shape[1].get("z_order", 0)))
        masks = (_mask(*shape, depth_mm.shape) for shape in ordered)
        parts, persons = images_from(masks, depth_mm.shape)
    except (ValueError, KeyError, OverflowError, FormatError) as error:
        raise FormatError(f"{source / ANNOTATIONS}, image {name[:100]!r}: {str(error)[:200]}") from error
    return companion.labels(name.removesuffix(".png"), depth_mm, parts, persons)


def _mask(kind: str, fields: dict[str, str], shape: tuple[int, int]) -> Mask:
    pixels = np.zeros(shape, bool)
    if kind == "polygon":
        pixels = _polygon(fields["points"], shape)
    else:
        left, top, width, height = (int(fields[name]) for name in ("left", "top", "width", "height"))
        inside = 0 <= left < left + width <= shape[1] and 0 <= top < top + height <= shape[0]
        if not inside:
            raise FormatError(f"a mask lies at {left}, {top}, {width}x{height} on an image of {shape}")
        runs = [int(n) for n in fields["rle"].split(",")]
        box = mask_from_runs(runs, width * height).reshape(height, width)
        pixels[top : top + height, left : left + width] = box
    return Mask(fields["label"], int(fields.get("person", 1)), pixels)


def _corners(text: str) -> int:
    return text.count(";") + 1


def _drawable(corners: list[int], rows: int) -> bool:
    """Whether polygons of so many corners are drawn on so many rows within seconds."""
    return max(corners, default=0) * rows <= MAX_CROSSINGS and sum(corners) * rows <= MAX_CROSSINGS_AN_IMAGE


def _polygon(text: str, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """CVAT's pixel centres lie at halves, OpenCV's at whole numbers."""
    points = [[float(x) for x in point.split(",")] for point in text.split(";")]
    corners = np.array(points, np.float64) - 0.5
    if corners.shape[1:] != (2,) or len(corners) < 3 or not (np.abs(corners) < 1e5).all():
        raise FormatError("a polygon has fewer than three corners on the image; export it again")
    canvas = np.zeros(shape, np.uint8)
    cv2.fillPoly(canvas, [np.rint(corners).astype(np.int32)], 1)
    return canvas.astype(bool)
