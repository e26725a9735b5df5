"""CVAT for images 1.1: ``annotations.xml`` with run-length masks, and the depth images in ``images/``.

Format: CVAT's documentation, "CVAT for image"; a mask's runs go row by row within its box, zeros first.
Polygons are read as well. XML with a document type, which entities and external references need, is refused.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DTDForbidden
from defusedxml.ElementTree import fromstring

from annotate.crop import window_of
from annotate.exchange.annotated_images import AnnotatedImage, check_size, read_annotated, write_image
from annotate.exchange.class_names import PERSON, check_names, mask_ids
from annotate.exchange.companion import MAX_TEXT_BYTES, Companion
from annotate.exchange.masks import (
    FEW_CORNERS,
    POLYGONS,
    Mask,
    mask_from_runs,
    masks_of,
    polygon_pixels,
    runs_of,
)
from annotate.frame_labels import FrameLabels
from annotate.scheme.scheme import UNDEFINED, Scheme
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

ANNOTATIONS = "annotations.xml"
NUMBER = (
    "<attribute><name>number</name><mutable>False</mutable><input_type>number</input_type>"
    "<default_value>1</default_value><values>1\n255\n1</values></attribute>"
)
"""Attribute of the label ``person``."""


def write_cvat(frames: Iterator[FrameLabels], companion: Companion, out: Path) -> None:
    """Write frames as CVAT for images 1.1 into an empty folder. Raises FormatError as ``mask_ids``."""
    labels = "".join(_labels(companion.scheme))
    with (out / ANNOTATIONS).open("w", encoding="ascii") as xml:
        xml.write('<?xml version="1.0" encoding="utf-8"?>\n<annotations>\n <version>1.1</version>\n')
        xml.write(f" <meta><task><labels>{labels}</labels></task></meta>\n")
        for number, frame in enumerate(frames):
            height, width = frame.parts.shape
            name = write_image(out, frame)
            xml.write(f' <image id="{number}" name="{name}" width="{width}" height="{height}">\n')
            xml.writelines(map(_mask_xml, masks_of(frame)))
            xml.write(" </image>\n")
        xml.write("</annotations>\n")


def _labels(scheme: Scheme) -> Iterator[str]:
    palette = scheme.palette_rgb()
    for name, part in {**mask_ids(scheme), PERSON: UNDEFINED}.items():
        color = "#{:02x}{:02x}{:02x}".format(*palette[part])
        yield f"<label><name>{name}</name><color>{color}</color><type>mask</type>"
        yield f"<attributes>{NUMBER if name == PERSON else ''}</attributes></label>"


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


def read_cvat(source: Path, companion: Companion) -> Iterator[FrameLabels]:
    """Yield the frames of a folder; shapes are masks or polygons. Raises FormatError for malformed
    annotations or images.
    """
    file = companion.annotations or source / ANNOTATIONS
    try:
        root = fromstring(read_bounded(file, MAX_TEXT_BYTES), forbid_dtd=True)
    except DTDForbidden as error:
        raise FormatError(f"{file} has a document type declaration; export it from CVAT again") from error
    except (ParseError, ValueError, LookupError) as error:
        raise FormatError(f"{file} is not XML ({str(error)[:80]}); export it from CVAT again") from error
    elements = list(root.iter("image"))
    if not elements:
        what = "tracks of a video" if next(root.iter("track"), None) is not None else "no image"
        raise FormatError(f"{file} holds {what}; export it as 'CVAT for images 1.1'")
    shapes = (one for image in elements for one in image if one.tag in ("mask", "polygon"))
    names = (one.get("label", "") for one in shapes)
    check_names(names, companion.ids_by_name, companion.scheme, file)
    images = [AnnotatedImage(file, one.get("name", ""), partial(_masks, one, companion)) for one in elements]
    yield from read_annotated(source, images, companion)


def _masks(image: Element, companion: Companion, shape: tuple[int, int]) -> Iterator[Mask]:
    """Yield the masks of an image's shapes in drawing order; other shapes are counted as remarks."""
    for one in image:
        if one.tag == "polygon":
            companion.remark(POLYGONS)
        elif one.tag != "mask":
            companion.remark(f"shapes of the kind {one.tag[:40]} are not read")
    shapes = [one for one in image if one.tag in ("mask", "polygon")]
    if shapes:
        check_size((image.get("height"), image.get("width")), shape)
    for one in sorted(shapes, key=lambda one: int(one.get("z_order", 0))):
        mask = _mask(one, shape, companion)
        if mask is not None:
            yield mask


def _mask(element: Element, shape: tuple[int, int], companion: Companion) -> Mask | None:
    """Return the mask that an element draws on an image of ``shape``; None for a polygon without an area."""
    fields = element.attrib
    person = int(element.findtext("attribute[@name='number']") or 1)
    if element.tag == "polygon":
        corners = [pair for pair in fields["points"].split(";") if pair.strip()]
        if len(corners) < 3:
            companion.remark(FEW_CORNERS)
            return None
        points = np.array([[float(x) for x in pair.split(",")] for pair in corners], np.float64)
        return Mask(fields["label"], person, polygon_pixels(points, shape))
    left, top, width, height = (round(float(fields[name])) for name in ("left", "top", "width", "height"))
    right, bottom = min(left + width, shape[1]), min(top + height, shape[0])
    if min(width, height) < 1 or max(width, height) > 4 * max(shape):
        raise FormatError(f"a mask is {width}x{height} on an image of {shape[1]}x{shape[0]}; export it again")
    box = mask_from_runs([int(n) for n in fields["rle"].split(",")], width * height).reshape(height, width)
    if left < 0 or top < 0 or right < left + width or bottom < top + height:
        companion.remark("masks reach outside their image; the part inside is read")
    pixels = np.zeros(shape, bool)
    inside = box[max(0, -top) : max(0, bottom - top), max(0, -left) : max(0, right - left)]
    top, left = max(0, top), max(0, left)
    pixels[top : top + inside.shape[0], left : left + inside.shape[1]] = inside
    return Mask(fields["label"], person, pixels)
