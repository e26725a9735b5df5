"""A running rig's newest labelled moment for Foxglove, by a thread of its own."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from annotate.foxglove.server import FoxgloveServer
from annotate.foxglove.topics import Shown
from annotate.live.live_frame import LiveFrame, Stance
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
    seen, told, standing = 0, 0, set[str]()
    while not stop.is_set():
        newest = pipeline.frames.after(seen, WAIT_S)
        if newest is None:
            if pipeline.frames.ended:
                return
            continue
        seen, frame = newest
        happened = [(number, event) for number, event in pipeline.rig.events.copy() if number > told]
        told = max((number for number, _ in happened), default=told)
        new = [complaint.text for complaint in frame.complaints if complaint.kind not in standing]
        standing = {complaint.kind for complaint in frame.complaints}
        texts = [event.text for _, event in happened] + new
        shown = shown_of(frame, pipeline.rig.calibration, texts)
        try:
            server.show(shown)
        except FormatError:
            # A colour image that was cut off on its way; the pipeline complains of it.
            server.show(replace(shown, color_encoded=None))


def shown_of(frame: LiveFrame, calibration: RigCalibration, texts: list[str]) -> Shown:
    """A live frame as Foxglove gets it, stamped by the host's clock. texts: what happened since the last."""
    recorded, stamp_ns = frame.moment.frame, frame.moment.host_ns
    return Shown(
        stamp_ns,
        frame.cloud,
        frame.labels.parts,
        calibration,
        recorded.color_encoded if calibration.color else None,
        recorded.thermal_c if calibration.thermal else None,
        _joints_mm(frame.stance),
        tuple((stamp_ns, text) for text in texts),
    )


def _joints_mm(stance: Stance | None) -> dict[str, list[float]] | None:
    if stance is None:
        return None
    return dict(zip(stance.names, (1000 * stance.joints_m).tolist(), strict=True))
