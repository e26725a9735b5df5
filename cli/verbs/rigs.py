"""The verb ``rig``: templates of common rigs."""

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from cli.console import Json, Overwrite, finish, table
from sensors.errors import DeviceError
from sensors.files.atomic import check_folder_name, check_free, replacing, write_bytes

if TYPE_CHECKING:
    from sensors.recording.rig_templates import RigTemplate

RIG, CALIBRATION, PLATE = "rig.toml", "calibration.json", "plate.svg"
COLUMNS = ("plate, m", "depth +-mm at 2 m", "mm of a thermal pixel at 2 m", "thermal view, degrees")


def names() -> list[str]:
    """Return the names of the rigs."""
    from sensors.recording.rig_templates import TEMPLATES

    return [*TEMPLATES]


def rig(
    name: Annotated[
        str | None,
        Argument(help="Name of a rig; without one, all are listed.", autocompletion=names),
    ] = None,
    out: Annotated[Path | None, Option(help="Folder for rig file, rough calibration and hole plate.")] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """List common rigs, or write the files of one: rig file, rough calibration, printable hole plate."""
    from sensors.calibrate.hole_plate import plate_svg
    from sensors.recording.rig_templates import TEMPLATES, template_named
    from sensors.rig.rig_calibration import save_calibration

    if name is None:
        expected = {one.name: expectations(one) for one in TEMPLATES.values()}
        rows = [(n, TEMPLATES[n].title, *map(str, e.values())) for n, e in expected.items()]
        finish({"rigs": expected}, json, table(("name", "cameras", *COLUMNS), rows))
        return
    template = template_named(name)
    if out is None:
        raise DeviceError(f"no folder for rig {name!r}; give --out FOLDER")
    check_folder_name(out)
    for file in (RIG, CALIBRATION, PLATE):
        check_free(out / file, overwrite)
    out.mkdir(parents=True, exist_ok=True)
    with replacing(out / CALIBRATION) as temporary:
        save_calibration(temporary, template.calibration)
    for file, text in ((PLATE, plate_svg(template.plate)), (RIG, rig_file(template))):
        write_bytes(out / file, text.encode())
    result = {"rig": str(out / RIG), **expectations(template)}
    finish(result, json, f"{out / RIG}: its comments are the next steps")


def expectations(rig: "RigTemplate") -> dict[str, Any]:
    """Return distances, errors and the thermal camera's field of view of a rig, by ``COLUMNS``."""
    import numpy as np

    from sensors.rig.camera import rays

    thermal = rig.calibration.thermal
    assert thermal is not None
    edges = rays(thermal)
    middle = (thermal.height // 2, thermal.width // 2)
    view = [
        round(float(np.degrees(np.arctan(ray[-1, axis]) - np.arctan(ray[0, axis]))))
        for ray, axis in ((edges[middle[0]], 0), (edges[:, middle[1]], 1))
    ]
    return {
        "plate_m": "{:g} to {:g}".format(*rig.plate_m),
        "depth_sd_mm": rig.depth_sd_mm,
        "thermal_pixel_mm": round(2000 / thermal.fx, 1),
        "thermal_view_deg": f"{view[0]} x {view[1]}",
    }


def rig_file(rig: "RigTemplate") -> str:
    """Return the rig file of a template; its comments list the steps to the first labels."""
    import numpy as np

    from sensors.calibrate.hole_plate import HolePlate

    plate, expected = rig.plate, expectations(rig)
    width, height = 1000 * np.ptp(plate.size_m, axis=0)
    hole, pitch = 1000 * plate.hole_m, 1000 * plate.pitch_m
    plate_options = "" if plate == HolePlate() else f" --pitch-mm {pitch:g} --hole-mm {hole:g}"
    return f"""\
# {rig.title}
# ({rig.remark})
#
# 1. annotate-cloud devices
#    Put the addresses that it lists below.
# 2. Print {PLATE} at 100 % ({width:g} x {height:g} mm), cut the holes ({hole:g} mm) into foam board,
#    and fix it 3 cm before something warm, a heating mat for instance.
# 3. annotate-cloud record board.mcap --rig {RIG} --infrared
#    Hold it still, {expected["plate_m"]} m away, in forty positions: tilted, and out to the images' corners.
# 4. annotate-cloud calibrate board.mcap --out {CALIBRATION} --overwrite{plate_options}
# 5. annotate-cloud record people.mcap --rig {RIG}
#    annotate-cloud label people.mcap --suit suit.toml --out labels    (predict, without a suit)
#
# At 2 m a depth reading is off by {rig.depth_sd_mm:g} mm (one sd), and a thermal pixel is
# {expected["thermal_pixel_mm"]:g} mm wide.
# Without cameras: annotate-cloud simulate people.mcap --rig {rig.name}
name = "{rig.name}"
calibration = "{CALIBRATION}"  # by data sheets, until step 4
devices = {json_format.dumps(rig.devices)}
"""
