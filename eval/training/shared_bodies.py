"""Bodies of labelled people: a synthetic person is a blend of two bodies and belongs to both."""

import re
from collections.abc import Collection, Iterable, Mapping
from typing import Any

from annotate.frame_labels import FrameLabels
from annotate.labelset.dataset import Dataset
from annotate.labelset.labelled_frames import LabelledFrames
from synth.data_files import CASTS, JUDGE, TRAINING, Cast

HELD_OUT = frozenset({"body_2", "body_5", "crowd_04", "crowd_13", "crowd_22"})
"""Bodies that the fitting tools do not train on, to calibrate on them: of the paper's eight and the crowd."""
BODIES = "bodies"  # note of a frame: the names of its person's bodies
_RIG = re.compile(r"virtual-(?P<judge>judge-)?.*-(?P<seed>[0-9]{1,18})")  # source of a virtual rig's truth
_SUBJECT = re.compile(r"subject-(?P<number>[0-9]{1,9})")


def bodies_in(frames: LabelledFrames, frame: FrameLabels) -> frozenset[str]:
    """Return the bodies of a frame's person, or the subject's name where its bodies are unknown."""
    noted = frame.notes.get(BODIES)
    if isinstance(noted, list) and noted:
        return frozenset(map(str, noted))
    if isinstance(frames, Dataset):
        return _of_image(frames.info, frame) or frozenset({frame.subject})
    return _of_rig(frames.info, frame.subject) or frozenset({frame.subject})


def held_out(sources: Iterable[LabelledFrames], names: Collection[str]) -> frozenset[str]:
    """Return the named bodies, and the bodies of the named subjects of virtual rigs."""
    found = set(names)
    for frames in sources:
        for name in names:
            found |= frozenset() if isinstance(frames, Dataset) else _of_rig(frames.info, name)
    return frozenset(found)


def _of_image(info: Mapping[str, Any], frame: FrameLabels) -> frozenset[str]:
    """Return the two bodies of a preset's image, recomputed from the dataset's seed; empty if unknown."""
    name, seed, cast = info.get("preset"), info.get("seed"), info.get("cast", TRAINING)
    if not isinstance(name, str) or not isinstance(seed, int) or cast not in CASTS:
        return frozenset()
    if not frame.frame_id.isdecimal():
        return frozenset()
    from synth.images.presets import blended_bodies

    first, second = blended_bodies(name, cast, seed, int(frame.frame_id)) or ("", "")
    # Another first body: the dataset is of another version, or its frames were renamed.
    return frozenset({first, second}) if first == frame.subject else frozenset()


def _of_rig(info: Mapping[str, Any], subject: str) -> frozenset[str]:
    """Return the bodies of a virtual rig's subject, recomputed from the rig's seed; empty if unknown."""
    source, person = _RIG.fullmatch(str(info.get("source", ""))), _SUBJECT.fullmatch(subject)
    if source is None or person is None:
        return frozenset()
    from synth.rig.episode import blended_bodies

    cast: Cast = JUDGE if source["judge"] else TRAINING
    return frozenset(blended_bodies(cast, int(source["seed"]), int(person["number"])))
