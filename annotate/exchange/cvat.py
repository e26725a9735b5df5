"""CVAT for images 1.1: ``annotations.xml`` with run-length masks, and the depth images in ``images/``.

Format: CVAT's documentation, "CVAT for image"; a mask's runs go row by row within its box, zeros first.
Polygons are read as well (a pixel belongs to one when its centre lies in it); masks are exact.
XML with a document type, which is what entities and external references need, is refused.
"""

from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DTDForbidden
from defusedxml.ElementTree import fromstring

from annotate.crop import window_of
from annotate.exchange.companion import MAX_TEXT_BYTES, Companion
from annotate.exchange.image_names import frame_ids, read_depth
from annotate.exchange.masks import MASK_IDS, PERSON, Mask, images_from, mask_from_runs, masks_of, runs_of
from annotate.exchange.polygons import POLYGONS, polygon_pixels
from annotate.frame_labels import FrameLabels
from annotate.labelset.images import encode_png
from annotate.parts import UNDEFINED, palette_rgb
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded
from sensors.rig.camera import Intrinsics

ANNOTATIONS, IMAGES = "annotations.xml", "images"
SHAPES = ("mask", "polygon")


def write_cvat(frames: Iterator[FrameLabels], camera: Intrinsics, out: Path) -> None:
    """Write into an empty folder."""
    (out / IMAGES).mkdir()
    with (out / ANNOTATIONS).open("w", encoding="ascii") as xml:
        xml.write('<?xml version="1.0" encoding="utf-8"?>\n<annotations>\n <version>1.1</version>\n')
        xml.write(f" <meta><task><labels>{''.join(_labels())}</labels></task></meta>\n")
        for number, frame in enumerate(frames):
            name = f"{frame.frame_id}.png"
            (out / IMAGES / name).write_bytes(encode_png(frame.depth_mm))
            height, width = frame.parts.shape
            xml.write(f' <image id="{number}" name="{name}" width="{width}" height="{height}">\n')
            xml.writelines(map(_mask_xml, masks_of(frame)))
            xml.write(" </image>\n")
        xml.write("</annotations>\n")


def read_cvat(source: Path, companion: Companion) -> Iterator[FrameLabels]:
    """The inverse of ``write_cvat``. Raises FormatError."""
    file = source / ANNOTATIONS
    try:
        images = list(fromstring(read_bounded(file, MAX_TEXT_BYTES), forbid_dtd=True).iter("image"))
    except DTDForbidden as error:
        raise FormatError(f"{file} has a document type; export it from CVAT again") from error
    except (ParseError, ValueError, LookupError) as error:
        raise FormatError(f"{file} is not XML ({str(error)[:80]}); export it from CVAT again") from error
    if not images:
        raise FormatError(f"{file} holds no image; give CVAT's 'CVAT for images 1.1'")
    ids = frame_ids([image.get("name", "") for image in images])
    yield from (_frame(source, *both, companion) for both in zip(images, ids, strict=True))


def _labels() -> Iterator[str]:
    for name, part in {**MASK_IDS, PERSON: UNDEFINED}.items():
        color = "#{:02x}{:02x}{:02x}".format(*palette_rgb()[part])
        number = "<attribute><name>number</name><mutable>False</mutable><input_type>number</input_type>"
        number += "<default_value>1</default_value><values>1\n255\n1</values></attribute>"
        attributes = number if name == PERSON else ""
        yield f"<label><name>{name}</name><color>{color}</color><type>mask</type>"
        yield f"<attributes>{attributes}</attributes></label>"


def _mask_xml(mask: Mask) -> str:
    rows, columns = window_of(mask.pixels)
    box = mask.pixels[rows, columns]
    rle = ", ".join(map(str, runs_of(box.ravel())))
    # Persons lie below the parts, or they would hide them.
    order = 0 if mask.name == PERSON else 1
    attribute = f'<attribute name="number">{mask.person}</attribute>' if mask.name == PERSON else ""
    place = f'left="{columns.start}" top="{rows.start}" width="{box.shape[1]}" height="{box.shape[0]}"'
    head = f'<mask label="{mask.name}" source="auto" occluded="0" rle="{rle}" {place} z_order="{order}">'
    return f"  {head}{attribute}</mask>\n"


def _frame(source: Path, image: Element, frame_id: str, companion: Companion) -> FrameLabels:
    name = image.get("name", "")
    for shape in image:
        if shape.tag == "polygon":
            companion.remark(POLYGONS)
        elif shape.tag != "mask":
            companion.remark(f"shapes of the kind {shape.tag[:40]} are not read")
    try:
        depth_mm = read_depth(source, name)
        shapes = (shape for shape in image if shape.tag in SHAPES)
        ordered = sorted(shapes, key=lambda shape: int(shape.get("z_order", 0)))
        parts, persons = images_from((_mask(shape, depth_mm.shape) for shape in ordered), depth_mm.shape)
    except (ValueError, KeyError, OverflowError, FormatError) as error:
        raise FormatError(f"{source / ANNOTATIONS}, image {name[:100]!r}: {str(error)[:200]}") from error
    return companion.labels(frame_id, depth_mm, parts, persons)


def _mask(element: Element, shape: tuple[int, int]) -> Mask:
    """The mask that an element draws on an image of ``shape``."""
    fields = element.attrib
    person = int(element.findtext("attribute[@name='number']") or 1)
    if element.tag == "polygon":
        points = [[float(x) for x in point.split(",")] for point in fields["points"].split(";")]
        return Mask(fields["label"], person, polygon_pixels(np.array(points, np.float64), shape))
    left, top, width, height = (int(fields[name]) for name in ("left", "top", "width", "height"))
    if not (0 <= left < left + width <= shape[1] and 0 <= top < top + height <= shape[0]):
        raise FormatError(f"a mask lies at {left}, {top}, {width}x{height} on an image of {shape}")
    pixels = np.zeros(shape, bool)
    box = mask_from_runs([int(n) for n in fields["rle"].split(",")], width * height)
    pixels[top : top + height, left : left + width] = box.reshape(height, width)
    return Mask(fields["label"], person, pixels)
