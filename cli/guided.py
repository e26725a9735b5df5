"""Guided calibration: views of the hole plate taken one after another, until they are enough."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import cv2
import numpy as np

from annotate.live.rig_warnings import rig_warnings
from cli.console import say
from cli.rig_devices import check_infrared, open_rig
from sensors.calibrate.bundle import Adjusted
from sensors.calibrate.guide import Guidance, PlateSetup, guide, is_new, next_placement
from sensors.calibrate.guide_picture import guide_picture
from sensors.calibrate.hole_plate import HolePlate
from sensors.calibrate.plate_view import PlateView, view_plate, with_all_cameras
from sensors.errors import CalibrationError, FormatError
from sensors.files.atomic import check_free, write_bytes
from sensors.interrupt import Ending, ended_by_signals, interrupted_by_signals, interruptible
from sensors.recording.live_rig import LiveRig
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.reader import Session
from sensors.session.writer import SessionWriter

STILL_PX = 1.0
"""Pixels of the depth camera by which the plate may move between two looks: more, and it is in motion."""

MOST_BLIND = 30
"""Frames in a row without infrared, which a camera's first may lack, after which none is to come. By eye."""


def guided_calibration(
    board: Path,
    plate: HolePlate,
    rig: Path | None,
    device: list[str] | None,
    picture: Path,
    overwrite: bool,
) -> Adjusted:
    """The calibration of the views that were taken, of a rig (recorded to ``board``) or of a session.

    Raises CalibrationError where they are too few.
    """
    picture.parent.mkdir(parents=True, exist_ok=True)
    if rig is None and not device:
        session = Session(board)
        check_infrared(session)
        now = guided(iter(session), plate, session.calibration, picture, None)
    else:
        check_free(board, overwrite)
        with (
            interrupted_by_signals(),
            closing(open_rig(rig, device, plate)) as running,
            ended_by_signals() as ending,
            ExitStack() as stack,
        ):
            views = Views(SessionWriter(board, running.calibration, running.name, overwrite=overwrite), stack)
            frames = rig_frames(running, ending)
            now = guided(frames, plate, running.calibration, picture, views.keep)
    if now.found is None:
        raise CalibrationError(
            f"{len(now.seen)} views of the plate were taken, which are too few; hold it as {picture} shows, "
            "still and in front of something warm, until all cameras see every hole"
        )
    return now.found


class Views:
    """The session of the views that were taken, begun with the first one: no view leaves no file."""

    def __init__(self, writer: SessionWriter, stack: ExitStack) -> None:
        self._writer, self._stack, self._begun = writer, stack, False

    def keep(self, frame: RigFrame) -> None:
        """Write a view."""
        if not self._begun:
            self._stack.enter_context(self._writer)
            self._begun = True
        self._writer.write(frame)


def guided(
    frames: Iterator[RigFrame],
    plate: HolePlate,
    guess: RigCalibration,
    picture: Path,
    keep: Callable[[RigFrame], None] | None,
) -> Guidance:
    """Look at frames until their views are enough, they end, or Ctrl-C; say and draw what is wanted next.

    picture: a PNG, written again at every look. keep: called with each frame whose view is taken, once the
    plate is held still; None = every frame is a view that was taken.
    """
    setup, views = PlateSetup.of(guess, plate), list[PlateView]()
    now, before = Guidance((), next_placement(()), None, False), None
    say(f"hold the plate {now.wanted.text if now.wanted else ''}; {picture} shows where")
    try:
        with interruptible():
            for frame in frames:
                if (looked := _looked(frame, plate, guess)) is None:
                    continue
                view, now_known = looked
                if now_known is not guess:
                    guess, setup = now_known, PlateSetup.of(now_known, plate)
                still = keep is None or _still(before, view)
                if still and is_new(view, views, setup):
                    views.append(view)
                    if keep is not None:
                        keep(frame)
                    now = guide(views, setup)
                    _report(now)
                drawn = guide_picture(now, views, view, frame.infrared, setup)
                write_bytes(picture, cv2.imencode(".png", drawn)[1].tobytes())
                if now.wanted is None:
                    break
                before = view
    except KeyboardInterrupt:
        say("stopped by Ctrl-C")
    return now


def _looked(
    frame: RigFrame, plate: HolePlate, guess: RigCalibration
) -> tuple[PlateView, RigCalibration] | None:
    """A frame's view of the plate, and the cameras by now; None of a frame that came cut off."""
    try:
        return view_plate(frame, plate, guess.depth), with_all_cameras(guess, frame)
    except FormatError as error:
        say(str(error))
        return None


def rig_frames(running: LiveRig, ending: Ending) -> Iterator[RigFrame]:
    """The newest frame of a rig again and again; it runs until the last is taken. Raises what ended it.

    Frames end with a signal, which interrupts nothing: they are being recorded.
    Says what is wrong with a rig that gives none. Raises CalibrationError where none has infrared.
    """
    running.start()
    seen, blind, told = 0, 0, set[str]()
    try:
        while not running.frames.ended:
            if ending.asked:
                say("stopped by a signal")
                break
            if (latest := running.frames.after(seen, 0.5)) is None:
                wrong = [one for one in rig_warnings(running.health()) if one.kind not in told]
                told |= {one.kind for one in wrong}
                for one in wrong:
                    say(one.text)
                continue
            seen, synced = latest
            blind = 0 if synced.frame.infrared is not None else blind + 1
            if blind == MOST_BLIND:
                raise CalibrationError(
                    f"the depth camera of {running.name!r} gives no infrared, in which the plate is found"
                )
            yield synced.frame
    finally:
        running.close()
    if running.error is not None:
        raise running.error


def _still(before: PlateView | None, view: PlateView) -> bool:
    if before is None or not {"depth"} <= before.centers_px.keys() & view.centers_px.keys():
        return False
    moved = before.centers_px["depth"] - view.centers_px["depth"]
    return bool(np.linalg.norm(moved, axis=1).max() < STILL_PX)


def _report(now: Guidance) -> None:
    say(f"view {len(now.seen)}: {now.seen[-1].text}" + (f"; {_sure(now.found)}" if now.found else ""))
    say("that is enough" if now.wanted is None else f"now hold it {now.wanted.text}")


def _sure(found: Adjusted) -> str:
    """How well poses are known by now: twice the standard deviation, as ``judge`` states it."""
    texts = []
    for name, sd in found.deviations.items():
        turn, shift = 2 * sd.rotation_deg.max(), 2 * sd.translation_mm
        texts.append(f"{name} to {turn:.3f} degrees, {shift[:2].max():.2f} and {shift[2]:.2f} mm")
    return "; ".join(texts)
