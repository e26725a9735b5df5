"""The verb ``calibrate``: solve the calibration of a rig, or check it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from cli.console import Json, Overwrite, finish, progress, say
from cli.extras import needing
from sensors.files.atomic import check_free, replacing
from sensors.session.recording_file import SUFFIX

if TYPE_CHECKING:
    from cli.guided import Guided
    from sensors.calibrate.bundle import Adjusted
    from sensors.calibrate.hole_plate import HolePlate

LONGER = {"depth": 200, "color": 400, "thermal": 60}  # length of a drawn arrow as a multiple of its residual
COLOR = "#1f6f8b"


def calibrate(
    board: Annotated[
        Path,
        Argument(
            help="Session that shows the hole plate; with --check, any session; with --live and a rig, the "
            "session to record the views to."
        ),
    ],
    out: Annotated[
        Path | None, Option(help="Calibration (JSON) to write; a plot is saved beside it.")
    ] = None,
    check: Annotated[
        bool,
        Option("--check", help="Only measure how well the session's calibration fits its images."),
    ] = False,
    live: Annotated[
        bool,
        Option(
            "--live",
            help="Print and draw the next view of the plate that is needed; stop when the "
            "calibration is good. Views come from the rig or devices, or else from the session.",
        ),
    ] = False,
    rig: Annotated[Path | None, Option(help="Rig file (TOML), for --live.")] = None,
    device: Annotated[list[str] | None, Option(help="Address, for --live; repeatable.")] = None,
    yaml: Annotated[
        Path | None, Option(help="Folder for the same calibration as YAML, for OpenCV and iai_kinect2.")
    ] = None,
    columns: Annotated[int, Option(help="Holes per row.", min=2, max=50)] = 4,
    rows: Annotated[int, Option(help="Rows of holes.")] = 11,
    pitch_mm: Annotated[float, Option(help="Distance between neighbouring rows.")] = 35.0,
    hole_mm: Annotated[float, Option(help="Diameter of a hole.")] = 22.0,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Solve intrinsics and relative poses of all cameras from a recording of the hole plate."""
    if check:
        _check(board, json)
        return
    if out is None:
        raise typer.BadParameter("give a file for the calibration, or --check", param_hint="--out")
    if not live and (rig is not None or device):
        raise typer.BadParameter("needs --live; without it, record the plate first", param_hint="--rig")
    plot = out.with_suffix(".png")
    check_free(out, overwrite, suffix=".json")
    for path in (plot, *([yaml] if yaml else [])):
        check_free(path, overwrite)
    with needing("rig"):
        import matplotlib  # noqa: F401
    from cli.guided import Guided
    from sensors.calibrate.hole_plate import HolePlate

    plate = HolePlate(columns, rows, pitch_mm / 1000, hole_mm / 1000)
    if live:
        found = _guide(Guided(board, rig, device, out.with_suffix(".guide.png"), overwrite), plate)
    else:
        found = _solve(board, plate)
    _write(found, out, yaml)
    _plot_residuals(plot, found)
    _finish(found, json, out, plot)


def _guide(guided: "Guided", plate: "HolePlate") -> "Adjusted":
    """Check the rig and the session to record, then calibrate with guidance."""
    from cli.rig_devices import rig_of

    if guided.rig is not None or guided.device:
        check_free(guided.board, guided.overwrite, suffix=SUFFIX)
        rig_of(guided.rig, guided.device)
    return guided.calibrate(plate)


def _finish(found: "Adjusted", json: bool, out: Path, plot: Path) -> None:
    """Print the verdict on a calibration, its findings and its files."""
    from sensors.calibrate.verdict import judge

    good, findings = judge(found)
    say(*(finding.text + (f": {finding.remedy}" if finding.remedy else "") for finding in findings))
    verdict = "good" if good else "not reliable yet, see above"
    finish(_result(found, good), json, f"{out}: {verdict}; errors drawn in {plot}")


def _write(found: "Adjusted", out: Path, yaml: Path | None) -> None:
    from sensors.calibration_files.calibration_yaml import write_yaml
    from sensors.rig.rig_calibration import save_calibration

    out.parent.mkdir(parents=True, exist_ok=True)
    with replacing(out) as temporary:
        save_calibration(temporary, found.calibration)
    if yaml is not None:
        write_yaml(yaml, found.calibration)


def _check(path: Path, json: bool) -> None:
    from annotate.person.alignment import measure_drift
    from sensors.session.reader import Session

    session = Session(path)
    drift = measure_drift(session, session.calibration)
    right, down = drift.shift_px
    verdict = "fits" if drift.is_tolerable else "record the hole plate and calibrate again"
    result = {
        "frames": drift.frames,
        "shift_px": [round(right, 2), round(down, 2)],
        "shift_px_sd": [round(sd, 2) for sd in drift.sd_px],
        "degrees": round(drift.degrees, 3),
        "good": drift.is_tolerable,
    }
    text = (
        f"temperatures lie {right:+.1f}, {down:+.1f} px (right, down; sd {max(drift.sd_px):.1f}) off the "
        f"depth image, {drift.degrees:.2f} degrees: {verdict}"
    )
    finish(result, json, text)


def _solve(path: Path, plate: "HolePlate") -> "Adjusted":
    from cli.rig_devices import check_infrared
    from sensors.calibrate.bundle import adjust
    from sensors.calibrate.plate_view import view_plate, with_all_cameras
    from sensors.session.reader import Session

    session = Session(path)
    check_infrared(session)
    views, guess = [], session.calibration
    with progress("find the plate", len(session)) as advance:
        for frame in session:
            guess = with_all_cameras(guess, frame)
            views.append(view_plate(frame, plate, guess.depth))
            advance(1)
    say(f"calibrating from {len(views)} views")
    return adjust(views, plate, guess)


def _result(found: "Adjusted", good: bool) -> dict[str, Any]:
    return {
        "reprojection_px": {name: round(seen.rms_px, 4) for name, seen in found.residuals.items()},
        "rotation_deg_sd": {n: sd.rotation_deg.round(5).tolist() for n, sd in found.deviations.items()},
        "translation_mm_sd": {n: sd.translation_mm.round(4).tolist() for n, sd in found.deviations.items()},
        "depth_shift_mm": round(found.calibration.depth_shift_mm, 3),
        "depth_shift_mm_sd": round(found.depth_shift_sd_mm, 3),
        "views": found.views,
        "left_out": list(found.left_out),
        "good": good,
    }


def _plot_residuals(path: Path, found: "Adjusted") -> None:
    """Write a PNG with the residuals as arrows in each image at the top, and their size by view below."""
    import numpy as np
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5 * len(found.residuals), 7), layout="constrained")
    axes = figure.subplots(2, len(found.residuals), squeeze=False)
    for column, (name, seen) in enumerate(found.residuals.items()):
        camera = getattr(found.calibration, name)
        image, bars = axes[0, column], axes[1, column]
        arrows = *seen.px.T, *(LONGER[name] * seen.error_px).T
        image.quiver(*arrows, angles="xy", scale_units="xy", scale=1, width=0.002, color=COLOR)
        image.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal")
        image.set_title(f"{name}: {seen.rms_px:.3f} px rms, arrows {LONGER[name]} times longer")
        views = np.unique(seen.view)
        square = np.square(seen.error_px).sum(axis=1)
        rms = [float(np.sqrt(square[seen.view == view].mean())) for view in views]
        bars.bar(views, rms, color=COLOR)
        bars.set(xlabel="frame", ylabel="rms, px")
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=100)
