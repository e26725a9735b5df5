"""Labels and counts of two schemes, converted to one scheme for comparison."""

import numpy as np

from annotate.array_types import UInt8
from annotate.frame_labels import FrameLabels
from annotate.labelset.convert import in_scheme
from annotate.scheme.merging import CommonScheme, conversion_table, finest_common
from annotate.scheme.scheme import Scheme
from eval.scores.counts import FrameCounts, shapes


def common_scheme(first: Scheme, second: Scheme, target: Scheme | None = None) -> CommonScheme:
    """Return ``target``, by default the finest common scheme, with the conversions to it.

    Raises FormatError where a part of ``first`` or ``second`` would be split.
    """
    if target is None:
        return finest_common(first, second)
    return CommonScheme(target, conversion_table(first, target), conversion_table(second, target))


def scheme_note(scheme: Scheme) -> str:
    """Return the name and the parts of the scheme of a comparison, for the output."""
    return f"compared in scheme {scheme.name}: {', '.join(part.name for part in scheme.parts)}"


def converted(frame: FrameLabels, scheme: Scheme, table: UInt8) -> FrameLabels:
    """Return a frame in another scheme; table: as ``conversion_table`` returns it."""
    return frame if frame.scheme == scheme else in_scheme(frame, scheme, table)


def converted_counts(counts: FrameCounts, scheme: Scheme, table: UInt8) -> FrameCounts:
    """Return counts in another scheme; table: as ``conversion_table`` returns it.

    Confusion and undefined pixels are exact; all other counts are 0, because they need the images.
    """
    leading = counts.flat.shape[:-1]
    by_name = shapes(scheme.n_classes).items()
    arrays = {name: np.zeros((*leading, *shape), counts.flat.dtype) for name, shape in by_name}
    ids = np.flatnonzero(counts.scheme.is_label[: counts.scheme.n_classes])
    groups = np.zeros((counts.scheme.n_classes, scheme.n_classes), counts.flat.dtype)
    groups[ids, table[ids]] = 1
    arrays["confusion"], arrays["undefined"] = groups.T @ counts.confusion @ groups, counts.undefined
    return FrameCounts.of(scheme, **arrays)
