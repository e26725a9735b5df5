"""Tables that ``make figures`` measures, in this order."""

from tools.figures import network, rig
from tools.figures.table import Table
from tools.measure import real_people

PLACES = {"frames": ".0f"} | dict.fromkeys(("person IoU", "mean recall", "boundary F, 2 px"), ".3f")
PLACES["swaps"] = ".1%"

TABLES = (
    Table(
        name="labels",
        kind="virtual",
        about="40 frames of each of eight people on a sofa; intervals over people. "
        "Found first: wrong pixels in the 30 % least confident supervoxels.",
        pages=("README.md",),
        columns=PLACES | {"calibration error": ".3f", "found first": ".2f", "CPU seconds a frame": ".2f"},
        measure=rig.labels,
    ),
    Table(
        name="network",
        kind="synthetic",
        about="intervals over people, 24 images of each (16 in sitting-test, recumbent, upright).",
        pages=("docs/figures.md",),
        columns={"images": ".0f", "mean recall": ".3f", "swaps": ".1%"}
        | {"facing to 20 degrees": ".3f", "posture": ".3f"},
        measure=network.synthetic,
    ),
    Table(
        name="real-people",
        kind="real",
        about="four people, Kinect v1, cut out (UTD-MHAD, for research; development data). "
        "A joint is right if pixels around the tracker's joint have a part that meets there.",
        pages=("docs/figures.md",),
        columns={"images": ".0f", "joints right": ".3f", "on the other side": ".1%"}
        | {"by more than 3 px": ".1%", "facing to 30 degrees": ".3f", "posture standing": ".3f"},
        measure=network.real,
        seeded=False,
        needs=real_people.PEOPLE,
    ),
    Table(
        name="cameras",
        kind="virtual",
        about="the same eight people on a sofa, every rig, two frames each, `normal`; intervals over people.",
        pages=("docs/devices.md",),
        columns={"frames": ".0f", "person IoU": ".3f", "recall, suit": ".3f", "recall, network": ".3f"},
        measure=rig.cameras,
    ),
    Table(
        name="effort",
        kind="virtual",
        about="simulated annotator, suit labels to 99 % within 2 px, eight frames of each of eight people; "
        "intervals over frames.",
        pages=("docs/figures.md",),
        columns={"frames": ".0f", "median, s": ".1f", "mean, s": ".1f"}
        | {"one key": ".0%", "right in the end": ".0%"},
        measure=rig.effort,
    ),
    Table(
        name="pyrometer",
        kind="virtual",
        about="two people at `hard`, thermal drift up to 2 K, four recordings of 30 frames; "
        "intervals over frames.",
        pages=("docs/devices.md",),
        columns={"frames": ".0f", "off, K": ".2f"}
        | {"person IoU, temperatures found": ".3f", "person IoU, fixed": ".3f"},
        measure=rig.drift,
    ),
    Table(
        name="inputs",
        kind="virtual",
        about="the suit network without each input, 24 frames of eight people a difficulty; "
        "intervals over people.",
        pages=("docs/ablation.md",),
        columns=PLACES | {"annotator, s": ".1f"},
        measure=rig.inputs,
    ),
)
