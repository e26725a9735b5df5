"""Write docs/foxglove-layout.json for Foxglove's app: ``python -m tools.docs.foxglove_layout``."""

import json
from pathlib import Path

from foxglove import layouts as fl

from annotate.foxglove import topics
from sensors.session.messages import COLOR, EVENTS

FILE = Path(__file__).parents[2] / "docs" / "foxglove-layout.json"


def cloud(title: str, topic: str) -> fl.ThreeDeePanel:
    """Return a view of a cloud and the skeleton from behind the rig, 3 m in front of the person."""
    points = fl.BaseRendererPointCloudTopicSettings(visible=True, point_size=3, color_mode="rgba-fields")
    skeleton = fl.BaseRendererSceneUpdateTopicSettings(visible=True)
    camera = fl.ThreeDeeCameraState(
        distance=3, phi=75, theta_offset=0, target_offset=(0, 2, 0), perspective=True
    )
    config = fl.ThreeDeeConfig(
        camera_state=camera,
        follow_tf=topics.UPRIGHT,
        follow_mode="follow-pose",
        topics={topic: points, topics.SKELETON: skeleton},
    )
    return fl.ThreeDeePanel(title=title, config=config)


def image(title: str, topic: str, calibration: str) -> fl.ImagePanel:
    mode = fl.ImageModeConfig(image_topic=topic, calibration_topic=calibration)
    return fl.ImagePanel(title=title, config=fl.ImageConfig(image_mode=mode))


def split(direction: str, *panels: fl.BasePanel | fl.SplitContainer) -> fl.SplitContainer:
    return fl.SplitContainer(direction=direction, items=[fl.SplitItem(content=panel) for panel in panels])


def layout() -> fl.Layout:
    clouds = split("row", cloud("Parts", topics.PART_CLOUD), cloud("Temperature", topics.HEAT_CLOUD))
    images = split(
        "row",
        image("Parts", topics.PARTS, "/depth/calibration"),
        image("Colour", COLOR, "/color/calibration"),
        image("Temperature", topics.HEAT, "/thermal/calibration"),
        fl.LogPanel(title="Events", config=fl.LogConfig(topic_to_render=EVENTS)),
    )
    return fl.Layout(content=split("column", clouds, images))


if __name__ == "__main__":
    FILE.write_text(json.dumps(json.loads(layout().to_json()), indent=1) + "\n")
