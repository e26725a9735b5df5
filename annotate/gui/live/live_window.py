"""Live window: a running rig as cloud and pictures, warnings, and the recording.

Constants are untuned unless a source is given.
"""

import time
from collections.abc import Callable, Iterator
from datetime import datetime
from functools import partial
from html import escape
from pathlib import Path

import numpy as np
import pyvista as pv
from PySide6.QtCore import Qt, QTimer
from PySide6.QtGui import QAction, QCloseEvent, QKeySequence
from PySide6.QtWidgets import (
    QGridLayout,
    QHBoxLayout,
    QInputDialog,
    QLabel,
    QMainWindow,
    QSplitter,
    QToolButton,
    QVBoxLayout,
    QWidget,
)
from pyvistaqt import QtInteractor

from annotate.gui.held_keys import KeyRepeatFilter
from annotate.gui.live.live_pictures import TITLES, joints_px, live_scene, pictures
from annotate.gui.live.live_tile import Tile
from annotate.gui.state.keys import Command
from annotate.gui.state.point_colors import Colouring, Look, Painting, colourings
from annotate.gui.state.scene import FrameScene
from annotate.gui.views.cloud_view import CloudView
from annotate.gui.views.drawing_layer import StrokeOptions
from annotate.gui.widgets.building_blocks import Elided, button, laid, line, named
from annotate.gui.widgets.dialogs import show_keys
from annotate.gui.widgets.theme import DARK, LIGHT, Theme, scaled, style_app
from annotate.live.live_frame import BodyPose, LiveFrame
from annotate.live.pipeline import LivePipeline
from annotate.live.warning import LiveWarning
from sensors.errors import CloudError

UPDATE_MS = 15  # ms between two updates: half a period of 30 Hz
# Least ms between two clouds; drawing one without a graphics card takes 40 ms of a core (measured).
CLOUD_MS = 100
RATE_FRAMES = 30  # frames over which the displayed rate is counted
BONE_PX = 4.0  # width of a bone in logical pixels
# Offset of the bones' depth in steps of the depth buffer: in front of all at 16 bits or more.
IN_FRONT = -66_000.0
ENDED = "The recording is played to its end"
CLOUD_COLOURINGS: tuple[Colouring, ...] = ("temperature", "part", "colour", "depth")
COMMANDS = (
    Command("record", "Space", "Recording", "Record", "Start or stop recording"),
    Command("mark", "M", "Recording", "Mark an event…", "Mark what happens now with a short text"),
    Command("name", "N", "Recording", "Name of the person…", "Written into the next recording"),
    Command("ahead", "A", "View", "From the camera", "Show the person as the depth camera sees them"),
    Command("colouring", "C", "View", "Next colouring", "Temperature, colour, parts or depth of the cloud"),
    Command("toggle_theme", "T", "View", "Light or dark"),
    Command("close", "Ctrl+Q", "View", "Close", "End the recording, and close"),
    Command("help", "F1", "View", "All keys", "Show this list"),
)


def takes(first: Path | None, now: Callable[[], datetime] = datetime.now) -> Iterator[Path]:
    """Yield paths of sessions to record to: ``first``, then free names with -2, -3, ...

    first: None names each session by the time of its start.
    """
    number = 1
    while True:
        stem = first or Path(f"take-{now():%Y%m%d-%H%M%S}.mcap")
        path = stem if number == 1 else stem.with_name(f"{stem.stem}-{number}{stem.suffix}")
        if not path.exists() or (first is not None and number == 1):
            yield path
            number = number + 1 if first else 1
        else:
            number += 1


class LiveWindow(QMainWindow):
    """Window that shows the latest frame of a running pipeline.

    takes: paths of sessions to record to. shown: number of displayed frames. subject: name of the person, ""
    if unknown. Closing the window ends a recording; the caller closes pipeline and rig.
    """

    def __init__(
        self, pipeline: LivePipeline, takes: Iterator[Path], theme: Theme, subject: str = ""
    ) -> None:
        super().__init__()
        self.pipeline, self.takes, self.theme, self.subject = pipeline, takes, theme, subject
        self.shown, self._seen = 0, 0
        self._message = ""
        self._recent_ns: list[int] = []
        self._cloud_ns = 0
        self._colouring: Colouring = "temperature"
        self._frame: LiveFrame | None = None
        style_app(theme)
        self.setWindowTitle(f"{pipeline.rig.name} - annotate-cloud live")
        self.banner, self.state = named(QLabel(), "banner"), named(QLabel(), "title")
        self.facts = named(Elided(), "quiet")
        for label, name in ((self.banner, "Warnings"), (self.state, "Recording"), (self.facts, "State")):
            label.setAccessibleName(name)
        self.state.setTextFormat(Qt.TextFormat.PlainText)
        self.banner.setTextFormat(Qt.TextFormat.RichText)
        self.banner.setWordWrap(True)
        self.tiles = {title: Tile(title, theme) for title in TITLES}
        self.cloud_view: CloudView | None = None
        self._bones: _Bones | None = None
        self._large = QSplitter(Qt.Orientation.Horizontal)
        self._lay_out()
        self.buttons: dict[str, QToolButton] = {}
        self.actions_by_name = self._bound()
        self._timer = QTimer(self, interval=UPDATE_MS)
        self._timer.timeout.connect(self.update_view)
        self._timer.start()

    def _lay_out(self) -> None:
        grid = QGridLayout()
        grid.setSpacing(2)
        for number, tile in enumerate(self.tiles.values()):
            grid.addWidget(tile, number // 2, number % 2)
        side = QWidget()
        side.setLayout(grid)
        grid.setContentsMargins(0, 0, 0, 0)
        self._large.addWidget(side)
        self._foot = laid(QHBoxLayout(), gap=6, margins=(8, 4, 8, 4))
        head = named(QWidget(), "panel")
        laid(QHBoxLayout(head), self.state, self.facts, gap=14, margins=(14, 6, 14, 6)).setStretch(1, 1)
        central = named(QWidget(), "panel")
        column = laid(QVBoxLayout(central), self.banner, head, line(), self._large, line(), self._foot)
        column.setStretchFactor(self._large, 1)
        self.setCentralWidget(central)
        self.resize(scaled(1280), scaled(760))
        self._show_banner(())

    def _bound(self) -> dict[str, QAction]:
        """Add the commands as actions with keys, and as buttons at the bottom; return the actions by name."""
        KeyRepeatFilter(self)
        actions = {}
        for command in COMMANDS:
            action = QAction(command.title, self)
            action.setShortcuts([QKeySequence(key) for key in command.keys])
            action.setAutoRepeat(command.repeats)
            action.triggered.connect(getattr(self, command.name))
            self.addAction(action)
            made = button(_button_text(command.title, action))
            made.setToolTip(command.hint)
            made.clicked.connect(action.trigger)
            self._foot.addWidget(made)
            self.buttons[command.name] = made
            actions[command.name] = action
        self._foot.addStretch(1)
        return actions

    def update_view(self) -> None:
        """Show the latest frame, warnings and state."""
        latest = self.pipeline.frames.after(self._seen, 0.0)
        if latest is not None:
            self._seen, frame = latest
            self._show(frame)
        self._show_banner(self.pipeline.warnings)
        self._show_state()

    def _show(self, frame: LiveFrame) -> None:
        self._frame, self.shown = frame, self.shown + 1
        self._recent_ns = [*self._recent_ns[-RATE_FRAMES:], frame.synced.arrival_ns]
        places = joints_px(frame)
        for title, rgb in pictures(frame).items():
            on_body = title in ("Parts", "Heat")
            self.tiles[title].load(rgb, places if on_body else None, frame.body_pose if on_body else None)
        now_ns = time.monotonic_ns()
        if self.cloud_view is None or now_ns - self._cloud_ns >= CLOUD_MS * 1e6:
            self._cloud_ns = now_ns
            self._show_cloud(frame)

    def _show_cloud(self, frame: LiveFrame) -> None:
        scene = live_scene(frame)
        opened = self.cloud_view is not None
        if self.cloud_view is None or self._bones is None:
            self._open_cloud(scene)
        assert self.cloud_view is not None and self._bones is not None
        colouring = self._colouring if self._colouring in colourings(scene) else "part"
        look, everything = Look(colouring, outlines=False), np.ones(frame.labels.depth_mm.size, np.bool_)
        self._bones.show(frame.body_pose)
        painting = Painting(scene, frame.labels.parts, look, {}, self.theme.ground_rgb)
        self.cloud_view.load(scene, painting, everything, keep=opened)

    def _open_cloud(self, scene: FrameScene) -> None:
        """Create the cloud view, which needs the first frame's cloud."""
        self.cloud_view = CloudView(scene, StrokeOptions())
        self.cloud_view.layer.hide()
        self.cloud_view.set_ground(self.theme.ground_rgb)
        self._bones = _Bones(self.cloud_view.plotter)
        self._large.insertWidget(0, self.cloud_view)
        self._large.setSizes([self.width() * 11 // 20, self.width() * 9 // 20])

    def _show_banner(self, warnings: tuple[LiveWarning, ...]) -> None:
        error = self.pipeline.error or self.pipeline.rig.error
        texts = ([str(error)] if error else []) + [warning.text for warning in warnings]
        self.banner.setVisible(bool(texts))
        text = "<br>".join(escape(text) for text in texts)
        if text != self.banner.text():
            self.banner.setText(text)
            self.banner.setStyleSheet(
                f"background: {self.theme.warn}; color: #1b1300; padding: 6px 14px; font-weight: 600"
            )

    def _show_state(self) -> None:
        health, frame = self.pipeline.rig.health(), self._frame
        ended = self.pipeline.frames.ended and not (self.pipeline.error or self.pipeline.rig.error)
        if health.recording is not None:
            minutes, seconds = divmod(int(health.recorded_s), 60)
            self.state.setText(f"● {health.recording.name}  {minutes}:{seconds:02d}")
        elif ended:
            self.state.setText(ENDED)
        else:
            self.state.setText("not recording")
        self.state.setStyleSheet(f"color: {self.theme.bad if health.recording else self.theme.quiet}")
        record = "End recording" if health.recording else "Record"
        self.actions_by_name["record"].setText(record)
        self.buttons["record"].setText(_button_text(record, self.actions_by_name["record"]))
        facts = [self._message, f"person: {self.subject}" if self.subject else ""]
        if frame is not None:
            if (body_pose := frame.body_pose) is not None:
                posture = body_pose.posture or "posture unclear"
                facts.append(f"{posture}, facing {body_pose.facing_deg:+.0f}°")
            rate = f"{self.rate_hz:.0f} labelled frames a second, {frame.latency_ms:.0f} ms old"
            facts.append(f"{self.shown} frames shown" if ended else rate)
        if not ended:
            facts += [f"{name} {stream.rate_hz:.0f}/s" for name, stream in health.streams.items()]
        facts.append(f"{health.dropped} dropped" if health.dropped else "")
        facts.append("flag closed" if health.flag_closed_s else "")
        self.facts.setText("   ·   ".join(filter(None, facts)))

    @property
    def rate_hz(self) -> float:
        """Return the recent display rate, in frames a second."""
        span_s = (self._recent_ns[-1] - self._recent_ns[0]) * 1e-9 if len(self._recent_ns) > 1 else 0.0
        return (len(self._recent_ns) - 1) / span_s if span_s > 0 else 0.0

    def record(self) -> None:
        """Start or end a recording."""
        rig = self.pipeline.rig
        self._act(self._end if rig.health().recording else self._begin)

    def mark(self) -> None:
        """Ask for a text, and add it as an event to the rig and to a running recording."""
        if text := self._entered("Mark an event", "What happens now?"):
            self._act(partial(self._mark, text))

    def help(self) -> None:
        """Show all keys."""
        show_keys(self, [(command.key, command.hint or command.title) for command in COMMANDS])

    def name(self) -> None:
        """Ask for the name of the next recording's person."""
        self.subject = self._entered("Name of the person", "Who is in view?", self.subject) or self.subject

    def ahead(self) -> None:
        """Turn the cloud view to the depth camera's viewpoint."""
        if self.cloud_view is not None:
            self.cloud_view.look_ahead()

    def colouring(self) -> None:
        """Switch to the next colouring of the cloud."""
        at = CLOUD_COLOURINGS.index(self._colouring) + 1
        self._colouring = CLOUD_COLOURINGS[at % len(CLOUD_COLOURINGS)]

    def toggle_theme(self) -> None:
        """Switch between light and dark."""
        self.theme = LIGHT if self.theme is DARK else DARK
        style_app(self.theme)
        for tile in self.tiles.values():
            tile.theme = self.theme
        if self.cloud_view is not None:
            self.cloud_view.set_ground(self.theme.ground_rgb)

    def _begin(self) -> None:
        path = next(self.takes)
        self.pipeline.rig.record(path, self.subject)
        self._message = ""

    def _end(self) -> None:
        path = self.pipeline.rig.end_recording()
        self._message = f"{path} is saved" if path else ""

    def _mark(self, text: str) -> None:
        self.pipeline.rig.mark(text)
        where = "" if self.pipeline.rig.health().recording else ", but nothing is recorded"
        self._message = f"Marked: {text}{where}"

    def _act(self, action: Callable[[], None]) -> None:
        try:
            action()
        except (CloudError, OSError) as error:
            self._message = str(error)

    def _entered(self, title: str, question: str, before: str = "") -> str:
        text, given = QInputDialog.getText(self, title, question, text=before)
        return text.strip() if given else ""

    def closeEvent(self, event: QCloseEvent) -> None:  # noqa: N802
        """End the recording, and close (Qt's hook)."""
        self._timer.stop()
        self._act(self._end)
        if self.cloud_view is not None:
            self.cloud_view.end()
        event.accept()


def _button_text(title: str, action: QAction) -> str:
    return f"{title}   {action.shortcut().toString()}"


class _Bones:
    """VTK actor of the skeleton, drawn over the body."""

    def __init__(self, plotter: QtInteractor) -> None:
        lines = pv.PolyData(np.zeros((2, 3)), lines=[2, 0, 1])
        self.actor = plotter.add_mesh(lines, color="white", line_width=BONE_PX, lighting=False, render=False)
        self.actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
        self.actor.mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0.0, IN_FRONT)
        self.actor.SetVisibility(False)

    def show(self, pose: BodyPose | None) -> None:
        """Show a pose, or nothing."""
        self.actor.SetVisibility(pose is not None)
        if pose is not None:
            lines = np.array([(2, a, b) for a, b in pose.bones]).ravel()
            self.actor.mapper.dataset = pv.PolyData(pose.joints_m, lines=lines)
