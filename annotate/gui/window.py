"""The correction window: frames, commands and strokes, and their outcome."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from PySide6.QtCore import QPointF, QTimer, Signal
from PySide6.QtGui import QCloseEvent, QColor

from annotate.array_types import UInt8
from annotate.correction.correction import Correction
from annotate.gui.background import Background
from annotate.gui.hand_keys import HandKeys
from annotate.gui.opening import first, restored
from annotate.gui.panels.bars import CHANGING, View
from annotate.gui.settings import order_key, recall
from annotate.gui.state.drawing import Drawing, Tool
from annotate.gui.state.edit_controller import Desk
from annotate.gui.state.frame_order import Filter, Order, Walk
from annotate.gui.state.keys import Settings
from annotate.gui.state.outcome import Done
from annotate.gui.state.scene import FrameScene, SceneReader
from annotate.gui.widgets import dialogs
from annotate.gui.widgets.theme import DARK, LIGHT, part_color
from annotate.gui.window_layout import Shell
from annotate.labelset.journal import NotSavedError
from annotate.labelset.stroke import Activity
from sensors.errors import CloudError

AT_ONCE_MS = 20
"""Milliseconds after which it is said what the window is busy with: a frame that was read ahead opens without
a flicker. Untuned."""
NO_RECORDING = "No recording found: reopen with --session RECORDING for colour and heat"
"""First sentence of a window that shows depth alone."""
Read = tuple[FrameScene, UInt8 | None]
"""A frame as it was read, and the parts (h, w) of the frame before."""


class CorrectionWindow(Shell):
    """Corrects one label set, and closes it when it is closed itself. ``commands.bind`` gives it commands.

    closed: it is closed, and everything saved. memory: file of what is remembered from one time to the next,
    None for nothing. Raises CloudError when no frame can be opened.
    """

    closed = Signal()

    def __init__(
        self, correction: Correction, reader: SceneReader, settings: Settings, memory: Path | None = None
    ) -> None:
        known, walk = recall(memory), Walk(correction, reader)
        walk.arrange(known.order(order_key(correction)), "all")
        opened = first(walk)
        desk = Desk(correction, opened.scene, opened.editor, opened.before)
        super().__init__(desk, walk, settings, known)
        self.correction, self.background = correction, Background()
        self._retry_declined, self._closing = False, False
        self.held = HandKeys(self)
        # What is ready at once shows no sentence in between; frames are saved when the next one is shown.
        self.busy_due = QTimer(self, singleShot=True, interval=AT_ONCE_MS)
        self.busy_due.timeout.connect(self._show_busy)
        self.leave_due = QTimer(self, singleShot=True, interval=0)
        self.leave_due.timeout.connect(lambda: self.act(lambda: correction.leave_others(self.frame_id)))
        self._connect()
        self.strip.frames.order(self.walk.frame_ids)
        self.choose(self.desk.part)
        self.show_theme()
        self.show_frame()
        if not reader.has_recording and not desk.scene.remark:
            self.status.show_done(Done(NO_RECORDING, "warn"), self.theme)

    # Frames

    @property
    def frame_id(self) -> str:
        """The frame that is open."""
        return self.desk.scene.labels.frame_id

    def open_frame(self, frame_id: str, then: Callable[[], Done | None] = lambda: None) -> None:
        """Open another frame, at once where it was read ahead; then do something on it."""
        if frame_id == self.frame_id or self.background.busy:
            return
        if shape := self.held.shape:
            self.strip.choose(self.frame_id)
            self.status.show_done(Done(shape, "warn"), self.theme)
            return

        def read() -> Read:
            return self.walk.read(frame_id), self.walk.parts_before(frame_id)

        def show(read: Read) -> None:
            self.act(partial(self._show_opened, read, then))

        def failed(error: CloudError) -> None:
            if restored(self.correction, frame_id, error, self):
                self.open_frame(frame_id, then)
                return
            self.strip.choose(self.frame_id)
            self.status.show_done(Done(str(error), "bad"), self.theme)

        self.busy(f"Opening frame {frame_id.lstrip('0') or '0'}…", read, show, failed)

    def _show_opened(self, read: Read, then: Callable[[], Done | None]) -> Done | None:
        if self.picture_due.isActive():
            self.refresh_picture()
        opened = self.walk.begin(*read)
        self.desk.put(opened.scene, opened.editor, opened.before)
        self.leave_due.start()
        if self.strip.frames.frame_ids is not self.walk.frame_ids:
            self.strip.frames.order(self.walk.frame_ids)
        self.show_frame()
        self.hover_again()
        return then()

    def show_anew(self, read: Read, done: Done) -> Done:
        """Show the open frame and all pictures as they were read after labels changed."""
        opened = self.walk.begin(*read)
        self.desk.put(opened.scene, opened.editor, opened.before)
        self.strip.frames.forget()
        self.arrange(self.walk.order, self.walk.filter)
        self.show_frame()
        return done

    def busy(
        self,
        text: str,
        work: Callable[[], object],
        then: Callable[..., None],
        failed: Callable[[CloudError], None] | None = None,
    ) -> None:
        """Do something beside the window, which takes no commands that change anything meanwhile."""

        def fail(error: CloudError) -> None:
            self.status.show_done(Done(str(error), "bad"), self.theme)

        self.background.run(text, work, then, failed or fail, self._idle)
        self.busy_due.start()

    def _idle(self) -> None:
        """Close a window that was to close when its work was done."""
        if self._closing and not self.background.busy:
            self.close()

    def _show_busy(self) -> None:
        if self.background.busy:
            self.status.show_done(Done(self.background.busy), self.theme)

    def arrange(self, order: Order, kept: Filter) -> None:
        """Show the frames in an order, and those that pass a filter."""
        self.walk.arrange(order, kept, self.frame_id)
        self.strip.frames.order(self.walk.frame_ids)
        self.strip.choose(self.frame_id)

    def go_to(self, number: str) -> Done | None:
        """Open the frame of this number, zeros at its beginning left out."""
        found = [i for i in self.walk.all_ids if number in (i, i.lstrip("0") or "0")]
        if not found:
            first, last = (i.lstrip("0") or "0" for i in (self.walk.all_ids[0], self.walk.all_ids[-1]))
            return Done(f"There is no frame {number}: they are numbered {first} to {last}", "warn")
        self.open_frame(found[0])
        return None

    # Showing

    def show_frame(self) -> None:
        """Show the frame on the desk everywhere."""
        self._shown = self.desk.shown()
        self.doubt = None
        self.hand.once = ""
        for view in self.views:
            view.pointing.cancel()
            view.pointing.show_under_pointer(None, "")
            view.load(self.desk.scene, self.colors(view), self._shown)
        self.strip.choose(self.frame_id)
        self.refresh()
        self.status.show_done(Done(self.desk.scene.remark, "warn"), self.theme)

    # Settings that keys change

    def choose(self, part: int) -> None:
        """Choose the part that strokes give."""
        self.desk.part, self.desk.giver = part, "part"
        self.hand.color = part_color(part, self.theme) if part else QColor("white")
        if self.desk.alone:
            self.recolor()
        self.hover_again()

    def set_tool(self, tool: Tool) -> None:
        """Choose another tool; a shape begun with the last one is dropped."""
        self.hand.tool = tool
        self.cancel_stroke()
        self.hover_again()

    def cancel_stroke(self) -> bool:
        """Drop the shapes being drawn and a command that waits for a click; whether there were any."""
        once, self.hand.once = self.hand.once, ""
        return sum(view.pointing.cancel() for view in self.views) > 0 or bool(once)

    def look_ahead(self) -> None:
        """Show the person as the depth camera sees them."""
        self.cloud_view.look_ahead()
        self.depth_pane.fit()

    def toggle_theme(self) -> None:
        """Switch between light and dark."""
        self.theme = LIGHT if self.theme is DARK else DARK
        self.style_app()
        self.show_theme()
        self.recolor()

    def toggle_help(self) -> None:
        """Show or hide the page of all keys; meanwhile no other command works."""
        shown = not self.key_page.isVisible()
        self.key_page.setVisible(shown)
        self.key_page.raise_()
        for name, action in self.actions_by_name.items():
            if name not in ("help", "cancel"):
                action.setEnabled(not shown and not self._refused(name))

    def _refused(self, name: str) -> bool:
        return self.correction.read_only and name in CHANGING

    # Actions

    def act(self, action: Callable[[], Done | None]) -> None:
        """Do something, and show its outcome or error."""
        try:
            done = action()
        except NotSavedError as error:
            # The stroke took effect nevertheless.
            self.recolor()
            done = self._not_saved(error)
        except CloudError as error:
            done = Done(str(error), "bad")
        if done is not None:
            if len(done.pixels):
                self.recolor(done.pixels)
                self.picture_due.start()
                self.hover_again()
            self.status.show_done(done, self.theme)
        self._retry_declined = self._retry_declined and self.correction.unsaved > 0
        self.refresh()

    def pointed(self) -> View | None:
        """The view that the pointer is in."""
        return next((view for view in self.views if view.pointing.place is not None), None)

    def under_pointer(self) -> int | None:
        """The pixel under the pointer, in whichever view it is."""
        view = self.pointed()
        return view.pixel_at(view.pointing.place) if view and view.pointing.place else None

    def _not_saved(self, error: NotSavedError) -> Done:
        """Ask whether to write again what the disk refused; once declined, not until it was written."""
        while not self._retry_declined and dialogs.ask_retry(self, str(error), self.correction.unsaved):
            try:
                self.correction.flush()
                return Done("Everything is saved again", "good")
            except NotSavedError as again:
                error = again
        self._retry_declined = True
        return Done(str(error), "bad")

    def _drawn(self, view: View, drawing: Drawing) -> None:
        start = view.pixel_at(QPointF(*drawing.start_px))
        if self.background.busy:
            self.status.show_done(Done(self.background.busy), self.theme)
        elif once := self.hand.once:
            self.hand.once = ""
            self.act(partial(self.at_pixel, once, start))
        elif drawing.tool == "piece":
            self.act(lambda: self.desk.piece(start, drawing))
        else:
            self.act(lambda: self.desk.stroke(drawing, start, view.pixels_in(drawing)))
        self.show_hovered(view, view.pointing.place)

    def at_pixel(self, name: str, pixel: int | None) -> Done:
        """Carry out a command that needs a place."""
        desk = self.desk
        actions = {"swap": desk.swap, "neighbour": desk.to_neighbour, "merge": desk.merge, "pick": desk.pick}
        done = actions[name](pixel)
        if name == "pick":
            self.choose(desk.part)
        return done

    def mark(self, activity: Activity) -> None:
        """Count the time since the last event for an activity."""
        if self.desk.editor:
            self.desk.editor.time.mark(activity)

    def _connect(self) -> None:
        for view in self.views:
            view.pointing.drawn.connect(partial(self._drawn, view))
            view.pointing.hovered.connect(partial(self.show_hovered, view))
            view.pointing.held.connect(self.show_next)
            view.moved.connect(partial(self.mark, "navigating"))
            view.moved.connect(partial(view.pointing.show_under_pointer, None, ""))
            bar = self.panes.bars[view]
            bar.coloured.connect(
                lambda name, view=view: self.set_look(view, replace(view.look, colouring=name))
            )
            bar.requested.connect(partial(self._requested_by, view))
        self.palette_.chosen.connect(lambda part: self.act(lambda: self.choose(part)))
        self.tools.requested.connect(self.requested)
        self.panel.ordered.connect(lambda name: self._arranged(name, self.walk.filter))
        self.panel.filtered.connect(lambda name: self._arranged(self.walk.order, name))
        self.panel.went.connect(lambda number: self.act(partial(self.go_to, number)))
        self.strip.opened.connect(self.open_frame)
        self.key_page.closed.connect(self.toggle_help)

    def _arranged(self, order: Order, kept: Filter) -> None:
        self.arrange(order, kept)
        self.refresh()

    def _requested_by(self, view: View, name: str) -> None:
        self.pane = view
        self.requested.emit(name)

    def closeEvent(self, event: QCloseEvent) -> None:  # noqa: N802
        """Qt's hook: close the window when everything is saved; it stays open otherwise.

        Work beside the window ends first, because it may write to the label set.
        """
        if self.background.busy and not self._closing:
            self._closing = True
            self.status.show_done(Done(f"{self.background.busy} Then the window closes"), self.theme)
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
        self.remember()
        self.closed.emit()
        self.walk.close()
        self.strip.frames.close()
        self.cloud_view.end()
        event.accept()
