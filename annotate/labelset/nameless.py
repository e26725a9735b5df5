"""Labels without names of people: a recorded person has a code, an annotator is left out."""

import hashlib
import re
from dataclasses import replace

from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet

_CODE = re.compile(r"person-[0-9a-f]{8}")


def person_code(name: str) -> str:
    """Return the code of a person, such as ``person-1f3870be``; a code, and "" for an unknown person, stay.

    One name has one code everywhere, so that scores count people. The code confirms a guessed name.
    """
    if not name or _CODE.fullmatch(name):
        return name
    return f"person-{hashlib.sha256(name.encode(errors='surrogatepass')).hexdigest()[:8]}"


def nameless(frame: FrameLabels) -> FrameLabels:
    """Return a frame with its subject's code, and without the annotator's name in its notes."""
    notes = {key: value for key, value in frame.notes.items() if key != "who"}
    return replace(frame, subject=person_code(frame.subject), notes=notes)


class NamelessLabelSet(LabelSet):
    """Label set that is read without names, for an export."""

    def read(self, frame_id: str, original: bool = False, persons: bool = True) -> FrameLabels:
        """Read one frame as ``LabelSet.read`` does, without names."""
        return nameless(super().read(frame_id, original, persons))
