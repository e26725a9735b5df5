"""A running rig's newest labelled moment for Foxglove, by a thread of its own."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from annotate.foxglove.server import FoxgloveServer
from annotate.foxglove.topics import Shown
from annotate.live.live_frame import BodyPose, LiveFrame
from annotate.live.pipeline import WAIT_S, LivePipeline
from sensors.errors import FormatError
from sensors.rig.rig_calibration import RigCalibration


@contextmanager
def streamed(pipeline: LivePipeline, server: FoxgloveServer) -> Iterator[None]:
    """Show every newest frame of the pipeline to the server's clients, until the end of the context.

    Frames that come while one is being sent are passed over. Raises at the end what ended it before.
    """
    stop, errors = threading.Event(), list[Exception]()

    def run() -> None:
        try:
            _stream(pipeline, server, stop)
        except Exception as error:  # raised below: here it would die with the thread
            errors.append(error)

    thread = threading.Thread(target=run, name="stream", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
    if errors:
        raise errors[0]


def _stream(pipeline: LivePipeline, server: FoxgloveServer, stop: threading.Event) -> None:
    seen, told = 0, _Told()
    while not stop.is_set():
        latest = pipeline.frames.after(seen, WAIT_S)
        texts = told.news(pipeline) if server.heard else []
        if latest is None:
            # No frame comes of a camera that is silent, or where labelling fails: this is when to say so.
            for text in texts:
                server.tell(time.time_ns(), text)
            if pipeline.frames.ended:
                return
            continue
        seen, frame = latest
        shown = shown_of(frame, pipeline.rig.calibration, texts)
        try:
            server.show(shown)
        except FormatError:
            # A colour image that was cut off on its way; the pipeline complains of it.
            server.show(replace(shown, color_encoded=None))


class _Told:
    """What a stream's clients have been told: events by their numbers, complaints by their kinds."""

    def __init__(self) -> None:
        self._number, self._active = 0, set[str]()

    def news(self, pipeline: LivePipeline) -> list[str]:
        """Events that are kept, then complaints that stand, as far as they are new since the last call."""
        happened = [(number, event) for number, event in pipeline.rig.events.copy() if number > self._number]
        self._number = max((number for number, _ in happened), default=self._number)
        warnings = pipeline.warnings
        new = [warning.text for warning in warnings if warning.kind not in self._active]
        self._active = {warning.kind for warning in warnings}
        return [event.text for _, event in happened] + new


def shown_of(frame: LiveFrame, calibration: RigCalibration, texts: list[str]) -> Shown:
    """A live frame as Foxglove gets it, stamped by the host's clock. texts: what happened since the last."""
    recorded, stamp_ns = frame.synced.frame, frame.synced.host_ns
    return Shown(
        stamp_ns,
        frame.cloud,
        frame.labels.parts,
        calibration,
        recorded.color_encoded if calibration.color else None,
        recorded.thermal_c if calibration.thermal else None,
        _joints_mm(frame.body_pose),
        tuple((stamp_ns, text) for text in texts),
    )


def _joints_mm(body_pose: BodyPose | None) -> dict[str, list[float]] | None:
    if body_pose is None:
        return None
    return dict(zip(body_pose.names, (1000 * body_pose.joints_m).tolist(), strict=True))
