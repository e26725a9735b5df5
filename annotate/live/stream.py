"""Stream of a running rig's latest labelled frame to Foxglove, by a thread."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from annotate.foxglove.server import FoxgloveServer
from annotate.foxglove.topics import Shown
from annotate.live.live_frame import LiveFrame
from annotate.live.pipeline import WAIT_S, LivePipeline
from sensors.errors import FormatError
from sensors.rig.rig_calibration import RigCalibration


@contextmanager
def streamed(pipeline: LivePipeline, server: FoxgloveServer) -> Iterator[None]:
    """Send every latest frame of the pipeline to the server's clients during the context.

    Frames that come during a transmission are skipped. Raises at the end the error that ended the stream.
    """
    stop, errors = threading.Event(), list[Exception]()

    def run() -> None:
        try:
            _stream(pipeline, server, stop)
        except Exception as error:  # raised below, not in this thread
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
    seen, sent = 0, _SentTexts()
    while not stop.is_set():
        latest = pipeline.frames.after(seen, WAIT_S)
        texts = sent.news(pipeline) if server.has_event_listeners else []
        if latest is None:
            # A silent camera or failing labels give no frame that could carry the texts.
            for text in texts:
                server.send_event(time.time_ns(), text)
            if pipeline.frames.ended:
                return
            continue
        seen, frame = latest
        shown = shown_of(frame, pipeline.rig.calibration, texts)
        try:
            server.show(shown)
        except FormatError:
            # The colour image is truncated; the pipeline warns about it.
            server.show(replace(shown, color_encoded=None))


class _SentTexts:
    """Texts already sent to the clients: events by number, warnings by kind."""

    def __init__(self) -> None:
        self._number, self._active = 0, set[str]()

    def news(self, pipeline: LivePipeline) -> list[str]:
        """Return events, then active warnings, that are new since the last call."""
        happened = [(number, event) for number, event in pipeline.rig.events.copy() if number > self._number]
        self._number = max((number for number, _ in happened), default=self._number)
        warnings = pipeline.warnings
        new = [warning.text for warning in warnings if warning.kind not in self._active]
        self._active = {warning.kind for warning in warnings}
        return [event.text for _, event in happened] + new


def shown_of(frame: LiveFrame, calibration: RigCalibration, texts: list[str]) -> Shown:
    """Return a live frame in the form that Foxglove displays, stamped by the host's clock.

    texts: events and warnings since the last frame.
    """
    recorded, stamp_ns, pose = frame.synced.frame, frame.synced.host_ns, frame.body_pose
    joints_mm = dict(zip(pose.names, (1000 * pose.joints_m).tolist(), strict=True)) if pose else None
    return Shown(
        stamp_ns,
        frame.cloud,
        frame.labels.parts,
        calibration,
        recorded.color_encoded if calibration.color else None,
        recorded.thermal_c if calibration.thermal else None,
        joints_mm,
        tuple((stamp_ns, text) for text in texts),
        frame.labels.scheme,
    )
