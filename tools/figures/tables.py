"""Tables that ``make figures`` measures, in this order."""

from tools.figures import inputs, joints, network, rig
from tools.figures.table import Table
from tools.measure import real_people, rgbd

PLACES = {"frames": ".0f"} | dict.fromkeys(("person IoU", "mean recall", "boundary F, 2 px"), ".3f")
PLACES["swaps"] = ".1%"
CPU = "CPU seconds a frame"
HOW_GOOD, DETAILS = ("docs/how-good.md",), ("docs/figures.md",)
REAL_SHARED = "[Choices between trainings](how-good.md#what-training-and-test-share) used these people."
SHARED = "[Training and test share](how-good.md#what-training-and-test-share) the simulator."
EIGHT = "eight people of the judging cast."
IMAGES = "judging cast; people are named after the nearer of their two bodies."
IMAGE_COLUMNS = {"images": ".0f", "mean recall": ".3f", "swaps": ".1%"} | {
    "facing to 20 degrees": ".3f",
    "posture": ".3f",
}

JOINTS = "[joints](how-good.md#joints) of `predict`, judging cast."
JOINT_COLUMNS = {"images": ".0f", "error, mm": ".1f", "within 100 mm": ".3f", "within 50 mm": ".3f"}

TABLES = (
    Table(
        name="rgbd",
        kind="real",
        about="a man on a sofa, a man from the hips up, and a floor without people; faces were blurred "
        f"after the judge's joints were found. {rgbd.ABOUT}",
        shared=REAL_SHARED,
        pages=HOW_GOOD,
        columns=rgbd.SHOWN,
        measure=rgbd.table,
        sheets=rgbd.sheets,
        seeded=False,
        needs=rgbd.RECORDINGS,
    ),
    Table(
        name="real-people",
        kind="real",
        about="four people, Kinect v1, cut out (UTD-MHAD, for research; development data); a take shows one. "
        "A joint is right if pixels around the tracker's joint have a part that meets there. On the other "
        "side: the part is the twin of one that meets there. By more than 3 px: also no pixel so near has a "
        "right part. The tracker is the truth, so no other baseline is measured.",
        shared=REAL_SHARED,
        pages=HOW_GOOD,
        columns={"images": ".0f", "joints right": ".3f", "on the other side": ".1%"}
        | {"by more than 3 px": ".1%", "facing to 30 degrees": ".3f"},
        measure=network.real,
        sheets=network.sheets_of_people,
        seeded=False,
        needs=real_people.PEOPLE,
    ),
    Table(
        name="joints",
        kind="mixed",
        about=f"{JOINTS} Rig: 40 frames of each of eight people. Real people: four, against the sensor's "
        "tracker, which gives no visibility; offsets are medians of the three others.",
        shared=f"{SHARED} {REAL_SHARED}",
        pages=HOW_GOOD,
        columns=JOINT_COLUMNS | {f"{seen}, mm": ".1f" for seen in ("visible", "hidden", "outside")},
        measure=joints.by_set,
        needs=real_people.PEOPLE,
    ),
    Table(
        name="joints-by",
        kind="simulated",
        about=f"{JOINTS} All presets together, all recordings of the rig together, both sides together.",
        shared=SHARED,
        pages=DETAILS,
        columns=JOINT_COLUMNS,
        measure=joints.by_group,
        apart=True,
    ),
    Table(
        name="labels",
        kind="virtual",
        about=f"40 frames of each of {EIGHT} Boundary F: of part borders within 2 px. Calibration error: "
        "mean gap between confidence and share of right pixels. Found first: share of the wrong pixels in "
        "the 30 % least confident supervoxels.",
        shared=SHARED,
        pages=HOW_GOOD,
        columns=PLACES | {"calibration error": ".3f", "found first": ".2f", CPU: ".2f"},
        measure=rig.labels,
        sheets=rig.sheets,
        timed=(CPU,),
    ),
    Table(
        name="network",
        kind="synthetic",
        about=f"{IMAGES} Facing, posture: shares of images; posture only where two have 50 images each.",
        shared=SHARED,
        pages=HOW_GOOD,
        columns=IMAGE_COLUMNS,
        measure=network.by_preset,
        sheets=network.sheets,
    ),
    Table(
        name="network-by",
        kind="synthetic",
        about=f"{IMAGES} Rows: kinds of images with 50 or more, and every fourth image changed.",
        shared=SHARED,
        pages=DETAILS,
        columns=IMAGE_COLUMNS,
        measure=network.by_kind,
        apart=True,
    ),
    Table(
        name="cameras",
        kind="virtual",
        about=f"every rig, two frames at `normal` of each of the same {EIGHT}",
        shared=SHARED,
        pages=("docs/devices.md",),
        columns={"frames": ".0f", "person IoU": ".3f", "recall, suit": ".3f", "recall, network": ".3f"},
        measure=rig.cameras,
    ),
    Table(
        name="effort",
        kind="virtual",
        about="simulated annotator corrects suit labels until 99 % of the pixels agree within 2 px, eight "
        f"frames of each of {EIGHT} Median, mean: seconds a frame. One key: frames that agree at once. "
        "Right in the end: frames that agree at last.",
        shared=SHARED,
        pages=HOW_GOOD,
        columns={"frames": ".0f", "median, s": ".1f", "mean, s": ".1f"}
        | {"one key": ".0%", "right in the end": ".0%"},
        measure=rig.effort,
    ),
    Table(
        name="pyrometer",
        kind="virtual",
        about="judging cast at `hard`, thermal drift up to 2 K, eight recordings of two people; "
        "intervals over recordings.",
        shared=SHARED,
        pages=("docs/devices.md",),
        columns={"frames": ".0f", "off, K": ".2f"}
        | {"person IoU, temperatures found": ".3f", "person IoU, fixed": ".3f"},
        measure=rig.drift,
    ),
    Table(
        name="inputs",
        kind="virtual",
        about=f"three frames a difficulty of each of {EIGHT} "
        "First row: scores; other rows: paired changes. Annotator: simulated, last frame of each person.",
        shared=SHARED,
        pages=("docs/ablation.md",),
        columns=inputs.COLUMNS,
        measure=inputs.inputs,
        apart=True,
    ),
)
