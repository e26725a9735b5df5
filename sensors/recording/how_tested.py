"""Needs of every kind of camera, and what its driver has been tested with: none has been run on hardware."""

from typing import NamedTuple


class Kind(NamedTuple):
    """needs: an extra, a library, or nothing. tested: what was in the hardware's place."""

    needs: str
    tested: str


KINDS = {
    "kinect2": Kind("libfreenect2", "a library with its interface"),
    "realsense": Kind("extra `realsense`", "the maker's SDK on its software device, and its recordings"),
    "azure": Kind("extra `kinect` (x86-64)", "the maker's SDK playing a real recording"),
    "orbbec": Kind("extra `orbbec`", "the maker's SDK playing a recording made by the tests"),
    "optris": Kind("nothing", "an imitated kernel"),
    "optris-direct": Kind("the vendor's libirimager", "a library with its interface"),
    "lepton": Kind("nothing", "frames built from the datasheet"),
    "boson": Kind("nothing", "an imitated kernel"),
    "y16": Kind("nothing", "an imitated kernel"),
    "pyrometer": Kind("nothing", "a pseudo-terminal"),
}
"""By the kind in a device's address; ``docs/devices.md`` says what is assumed of each."""
