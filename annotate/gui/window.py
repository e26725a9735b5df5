"""The correction window: its frames, the actions on them, and their outcomes."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from PySide6.QtCore import QPointF, QTimer, Signal
from PySide6.QtGui import QAction, QCloseEvent, QColor
from PySide6.QtWidgets import QMainWindow

from annotate.correction.correction import Correction
from annotate.gui.background import Background, Task
from annotate.gui.held_keys import HeldKeys
from annotate.gui.panels.layout import Panels
from annotate.gui.placement import Placement
from annotate.gui.settings import Memory, order_key
from annotate.gui.state.drawing import Drawing, Tool
from annotate.gui.state.edit_controller import EditController
from annotate.gui.state.frame_order import ORDERS, Filter, FrameOrder, FrameRead, Order
from annotate.gui.state.keys import Settings
from annotate.gui.state.outcome import Outcome
from annotate.gui.state.scene import SceneReader
from annotate.gui.views.drawing_layer import StrokeOptions
from annotate.gui.views.view_pair import View, ViewPair
from annotate.gui.widgets import dialogs
from annotate.gui.widgets.theme import DARK, Theme, part_color, style_app, theme_of
from annotate.labelset.journal import NotSavedError
from annotate.labelset.stroke import Activity
from sensors.errors import CloudError

AT_ONCE_MS = 20  # delay of the sentence on running work, because a frame that was read ahead opens at once
STRIP_MS = 150  # delay of the frame's picture after a stroke; untuned
NO_RECORDING = "No recording found: reopen with --session RECORDING for colour and heat"


class CorrectionWindow(QMainWindow):
    """Window that corrects one label set, and closes the set with itself.

    ``commands.bind`` adds commands. memory: stored settings. requested: signal that the button of a command
    was clicked. closed: signal that all is saved. Raises CloudError when no frame can be opened.
    """

    requested = Signal(str)
    closed = Signal()

    def __init__(
        self, correction: Correction, reader: SceneReader, settings: Settings, memory: Path | None = None
    ) -> None:
        self.memory, self.frames = Memory(memory), FrameOrder(correction, reader)
        self.frames.arrange(self.memory.choice(order_key(correction), ORDERS, "time"), "all")
        frame = self.frames.begin_first(
            lambda frame_id, error: dialogs.restored(correction, frame_id, error, None)
        )
        super().__init__()
        self.correction, self.settings, self.background = correction, settings, Background()
        self.edits = EditController(correction, frame)
        self.actions_by_name: dict[str, QAction] = {}
        own = self.memory.choice("theme", ("light", "dark"), settings.theme)
        self.theme = theme_of(own if settings.theme == "system" else settings.theme)
        # Before there are widgets, because styling them one by one is quicker than all at once.
        style_app(self.theme)
        self.options = StrokeOptions()
        self.views = ViewPair(self.edits, self.options, self.theme)
        self.panels = Panels(self.views, self.frames, settings)
        self.setCentralWidget(self.panels)
        self.setWindowTitle(f"{correction.labels.path.resolve().name} - annotate-cloud")
        self.held = HeldKeys(self, self.views)
        self._doubt: str | None = None
        self._retry_declined, self._closing = False, False
        self.words_due = self._timer(0, self._show_words)
        self.picture_due = self._timer(STRIP_MS, self.refresh_picture)
        self.busy_due = self._timer(AT_ONCE_MS, self._show_busy)
        # Frames are saved when the next one is shown.
        self.leave_due = self._timer(0, lambda: self.act(lambda: correction.leave_others(self.frame_id)))
        self._placement = Placement(self, self.memory, self.views, self.panels.panes)
        self._connect()
        self.panels.strip.model_.order(self.frames.frame_ids)
        self.choose(self.edits.part)
        self.panels.set_theme(self.theme)
        self.views.set_theme(self.theme)
        self.show_frame()
        if not reader.has_recording and not frame.scene.remark:
            self.say(Outcome(NO_RECORDING, "warn"))

    def _timer(self, after_ms: int, action: Callable[[], None]) -> QTimer:
        timer = QTimer(self, singleShot=True, interval=after_ms)
        timer.timeout.connect(action)
        return timer

    def _connect(self) -> None:
        self.views.changed.connect(self.refresh)
        self.held.said.connect(self.say)
        self.held.changed.connect(self.refresh)
        for view in self.views:
            view.layer.drawn.connect(partial(self._drawn, view))
            view.layer.hovered.connect(partial(self.views.show_hovered, view))
            view.layer.held.connect(self.refresh)
            view.moved.connect(partial(self.mark, "navigating"))
            view.moved.connect(partial(view.layer.show_under_pointer, None, ""))
            bar = self.panels.panes.bars[view]
            bar.coloured.connect(
                lambda name, view=view: self.views.set_look(view, replace(view.look, colouring=name))
            )
            bar.requested.connect(lambda name, view=view: self._request(view, name))
        self.panels.palette_.chosen.connect(lambda part: self.act(lambda: self.choose(part)))
        self.panels.tools.requested.connect(self.requested)
        self.panels.progress.ordered.connect(lambda name: self.arrange(name, self.frames.filter))
        self.panels.progress.filtered.connect(lambda name: self.arrange(self.frames.order, name))
        self.panels.progress.went.connect(lambda number: self.act(partial(self.go_to, number)))
        self.panels.strip.opened.connect(self.open_frame)

    def _request(self, view: View, name: str) -> None:
        self.views.last = view
        self.requested.emit(name)

    # Frames

    @property
    def frame_id(self) -> str:
        """Return the id of the open frame."""
        return self.edits.frame.frame_id

    def open_frame(self, frame_id: str, then: Callable[[], Outcome | None] = lambda: None) -> None:
        """Open another frame, without delay if it was read in advance; then call ``then``."""
        if frame_id == self.frame_id or self.background.busy:
            return
        if shape := self.held.shape:
            self.panels.strip.choose(self.frame_id)
            self.say(Outcome(shape, "warn"))
            return

        def failed(error: CloudError) -> None:
            if dialogs.restored(self.correction, frame_id, error, self):
                self.open_frame(frame_id, then)
                return
            self.panels.strip.choose(self.frame_id)
            self.say(Outcome(str(error), "bad"))

        def show(read: FrameRead) -> None:
            self.act(partial(self._show_opened, read, then))

        text = f"Opening frame {frame_id.lstrip('0') or '0'}…"
        self.busy(Task(text, partial(self.frames.read, frame_id), show, failed))

    def _show_opened(self, read: FrameRead, then: Callable[[], Outcome | None]) -> Outcome | None:
        if self.picture_due.isActive():
            self.refresh_picture()
        self.edits.open(self.frames.begin(read))
        self.leave_due.start()
        if self.panels.strip.model_.frame_ids is not self.frames.frame_ids:
            self.panels.strip.model_.order(self.frames.frame_ids)
        self.show_frame()
        self.views.hover_again()
        return then()

    def show_anew(self, read: FrameRead, done: Outcome) -> Outcome:
        """Reload the open frame and all pictures after labels changed; return ``done``, the outcome to show.

        read: the open frame, read again.
        """
        self.edits.open(self.frames.begin(read))
        self.panels.strip.model_.forget()
        self.arrange(self.frames.order, self.frames.filter)
        self.show_frame()
        return done

    def arrange(self, order: Order, kept: Filter) -> None:
        """Set order and filter of the shown frames."""
        self.frames.arrange(order, kept, self.frame_id)
        self.panels.strip.model_.order(self.frames.frame_ids)
        self.panels.strip.choose(self.frame_id)
        self.refresh()

    def go_to(self, number: str) -> Outcome | None:
        """Open the frame with a number; leading zeros may be omitted."""
        ids = self.frames.all_ids
        found = [i for i in ids if number in (i, i.lstrip("0") or "0")]
        if not found:
            first, last = (i.lstrip("0") or "0" for i in (ids[0], ids[-1]))
            return Outcome(f"Frame {number} does not exist: frames are numbered {first} to {last}", "warn")
        self.open_frame(found[0])
        return None

    # Work beside the window

    def busy(self, task: Task) -> None:
        """Run a task in the background; commands that change anything are refused until it ends."""
        self.background.run(task, lambda error: self.say(Outcome(str(error), "bad")), self._idle)
        self.busy_due.start()

    def _idle(self) -> None:
        """Close the window if its closing waited for a background task."""
        if self._closing and not self.background.busy:
            self.close()

    def _show_busy(self) -> None:
        if self.background.busy:
            self.say(Outcome(self.background.busy))

    # Showing

    def say(self, done: Outcome | None) -> None:
        """Show an outcome in the status line."""
        if done is not None:
            self.panels.status.show_done(done, self.theme)

    def show_frame(self) -> None:
        """Update all views and panels to the open frame."""
        self._doubt = None
        self.views.load()
        self.panels.strip.choose(self.frame_id)
        self.refresh()
        self.say(Outcome(self.edits.frame.scene.remark, "warn"))

    def refresh(self) -> None:
        """Update palette, tools, header and texts, after all pending events."""
        self.words_due.start()

    def _show_words(self) -> None:
        if self._doubt is None:
            self._doubt = next((f"look at {doubt.reason}" for doubt in self.edits.frame.doubts()), "")
        enabled = {name: action.isEnabled() for name, action in self.actions_by_name.items()}
        self.panels.show_edits(self.edits, self.theme, self._doubt, enabled)
        self.views.show_scales()

    def refresh_picture(self) -> None:
        """Draw the frame's picture in the strip again, from its current labels."""
        self.picture_due.stop()
        labels = self.edits.frame.scene.labels
        self.panels.strip.model_.refresh(replace(labels, parts=self.edits.parts.copy()))

    def choose(self, part: int) -> None:
        """Choose the part that strokes assign."""
        self.edits.part, self.edits.giver = part, "part"
        self.options.color = part_color(self.edits.scheme, part, self.theme) if part else QColor("white")
        if self.edits.display.alone:
            self.views.recolor()
        self.views.hover_again()

    def set_tool(self, tool: Tool) -> None:
        """Choose another tool; an unfinished shape of the last tool is dropped."""
        self.options.tool = tool
        self.views.cancel()
        self.views.hover_again()

    def show_theme(self, theme: Theme) -> None:
        """Apply the colours of a theme to the window."""
        self.theme = theme
        style_app(theme)
        self.panels.set_theme(theme)
        self.views.set_theme(theme)
        self.views.recolor()

    # Actions

    def act(self, action: Callable[[], Outcome | None]) -> None:
        """Run an action, and show its outcome or error."""
        try:
            done = action()
        except NotSavedError as error:
            # The stroke took effect nevertheless.
            self.views.recolor()
            done = self._not_saved(error)
        except CloudError as error:
            done = Outcome(str(error), "bad")
        if done is not None and len(done.pixels):
            self.views.recolor(done.pixels)
            self.picture_due.start()
            self.views.hover_again()
        self.say(done)
        self._retry_declined = self._retry_declined and self.correction.unsaved > 0
        self.refresh()

    def _not_saved(self, error: NotSavedError) -> Outcome:
        """Ask whether to write again; if the user declines, do not ask again until the strokes are saved."""
        while not self._retry_declined and dialogs.ask_retry(self, str(error), self.correction.unsaved):
            try:
                self.correction.flush()
                return Outcome("Everything is saved again", "good")
            except NotSavedError as again:
                error = again
        self._retry_declined = True
        return Outcome(str(error), "bad")

    def _drawn(self, view: View, drawing: Drawing) -> None:
        start = view.pixel_at(QPointF(*drawing.start_px))
        if self.background.busy:
            self.say(Outcome(self.background.busy))
        elif once := self.options.once:
            self.options.once = ""
            self.act(partial(self.at_pixel, once, start))
        elif drawing.tool == "piece":
            self.act(lambda: self.edits.piece(start, drawing))
        else:
            self.act(lambda: self.edits.stroke(drawing, start, view.pixels_in(drawing)))
        self.views.show_hovered(view, view.layer.place)

    def at_pixel(self, name: str, pixel: int | None) -> Outcome:
        """Run a command that acts on a place, at a pixel."""
        edits = self.edits
        actions = {
            "swap": edits.swap,
            "neighbour": edits.to_neighbour,
            "merge": edits.merge,
            "pick": edits.pick,
        }
        done = actions[name](pixel)
        if name == "pick":
            self.choose(edits.part)
        return done

    def mark(self, activity: Activity) -> None:
        """Count the time since the last event as spent on an activity."""
        if editor := self.edits.frame.editor:
            editor.time.mark(activity)

    def closeEvent(self, event: QCloseEvent) -> None:  # noqa: N802
        """Save and close; keep the window open if saving fails and the user wants no losses (Qt's hook).

        Background work ends first, because it may write to the label set.
        """
        if self.background.busy and not self._closing:
            self._closing = True
            self.say(Outcome(f"{self.background.busy} Then the window closes"))
            event.ignore()
            return
        self.background.close()
        try:
            self.correction.close()
        except NotSavedError:
            if not dialogs.ask_close(self, self.correction.unsaved):
                self._closing = False
                self.background = Background()
                event.ignore()
                return
            self.correction.abandon()
        for due in (self.words_due, self.busy_due, self.leave_due, self.picture_due, self.held.peek_due):
            due.stop()
        self.memory.put("theme", "dark" if self.theme is DARK else "light")
        self.memory.put(order_key(self.correction), self.frames.order)
        self._placement.remember()
        self.closed.emit()
        self.frames.close()
        self.panels.strip.model_.close()
        self.views.cloud.end()
        event.accept()
