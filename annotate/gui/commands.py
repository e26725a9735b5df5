"""What each command does in the window: the names of ``keys.COMMANDS``, their actions, menus and keys."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeVar

from PySide6.QtGui import QAction, QKeySequence
from PySide6.QtWidgets import QMenu

from annotate.gui.key_repeat import HeldKeys
from annotate.gui.learning import Learner, Lesson
from annotate.gui.panels.bars import CHANGING, SWITCHES
from annotate.gui.state.drawing import TOOLS
from annotate.gui.state.frame_order import FILTERS, ORDERS
from annotate.gui.state.keys import Command, key_of
from annotate.gui.state.outcome import Done
from annotate.gui.state.point_colors import TINTS, colourings
from annotate.gui.widgets.dialogs import ask_export, ask_reason
from annotate.gui.window import CorrectionWindow
from annotate.parts import PARTS, UNDEFINED
from sensors.errors import CloudError

C = TypeVar("C")
Action = Callable[[], Done | None]
BRUSHES_PX = {"small": 9.0, "medium": 18.0, "large": 30.0}
"""Radii of the brush in logical pixels of the screen. Untuned."""
BRUSH_STEP = 1.15
"""Factor of one step of the brush's radius. Untuned."""
STROKE_SETUP = {
    *(part.name for part in PARTS),
    *("undefined", "pick", "from_other", "from_before", *SWITCHES, *BRUSHES_PX, *TOOLS),
}
"""Commands that count towards the price of the stroke that follows them."""
POINTED = ("swap", "neighbour", "merge", "pick")
"""Commands that need a place: the pointer's, or else that of the next click."""
MENUS = {
    "File": "&File",
    "Edit": "Ed&it",
    "Parts": "&Parts",
    "Tools": "&Tools",
    "Frames": "F&rames",
    "View": "&View",
    "Help": "&Help",
}
"""Menus with their keys, none of which fades a part."""
SUBMENUS = {"Lock": "Parts", "Fade": "Parts"}
CHECKABLE = {*TOOLS, *SWITCHES, "carry", "onion", "solo", "peek", "from_other", "from_before", "help"}


def bind(window: CorrectionWindow, lesson: Lesson | None = None) -> None:
    """Give a window its commands: menus, keys, and the actions behind its buttons. lesson: how to learn."""
    HeldKeys(window).repeated.connect(window.held.repeated)
    actions = _actions(window)
    judged, learner = Judged(window), Learner(window, lesson)
    actions |= {"learn": learner.learn, "stop_learning": learner.stop_now, "unlearn": learner.unlearn}
    actions |= {"accept": judged.accept, "reject": judged.reject, "overrule": judged.overrule}
    actions["undo"] = judged.undo
    run = partial(_run, window, actions)
    menus = {name: window.header.menus.addMenu(title) for name, title in MENUS.items()}
    menus |= {name: menus[above].addMenu(f"{name} a part") for name, above in SUBMENUS.items()}
    for command in window.settings.commands:
        window.actions_by_name[command.name] = _made(window, command, menus[command.menu], run)
    for name, action in window.actions_by_name.items():
        action.setEnabled(not (window.correction.read_only and name in CHANGING))
    for menu in menus.values():
        menu.aboutToShow.connect(partial(_check, window))
    for view in window.views:
        view.pointing.sampled.connect(partial(run, "pick"))
    window.requested.connect(lambda name: _arm(window, name) if name in POINTED else run(name))
    window.palette_.locked.connect(lambda part: window.act(partial(window.desk.toggle_lock, part)))
    window.palette_.faded.connect(lambda part: window.act(partial(window.desk.fade, part)))
    window.refresh()


def _made(window: CorrectionWindow, command: Command, menu: QMenu, run: Callable[[str], None]) -> QAction:
    action = QAction(command.title, window)
    action.setCheckable(command.name in CHECKABLE)
    action.setToolTip(command.hint or command.title)
    action.setStatusTip(command.hint)
    action.setAutoRepeat(command.repeats)
    if command.name == "peek":
        # Held, so that it is the window's own: see ``keyPressEvent``.
        action.setText(f"{command.title}\t{command.key}")
        action.setData(key_of(command.key))
    else:
        action.setShortcuts([QKeySequence(key) for key in command.keys])
    action.triggered.connect(partial(run, command.name))
    menu.addAction(action)
    window.addAction(action)
    return action


def _check(window: CorrectionWindow) -> None:
    """Tick the menu entries of what is on."""
    hand, desk = window.hand, window.desk
    on = {hand.tool, *(name for name in SWITCHES if getattr(hand, name)), f"from_{desk.giver}"}
    states = {"carry": desk.carrying, "onion": desk.onion, "solo": desk.alone, "peek": window.peeking}
    on |= {name for name, state in states.items() if state}
    for name in CHECKABLE:
        window.actions_by_name[name].setChecked(name in on)


def _run(window: CorrectionWindow, actions: dict[str, Action], name: str, *_: object) -> None:
    command = window.settings.command(name)
    if name == "undo" and (done := window.held.remove_corner()):
        window.status.show_done(done, window.theme)
        return
    refusal = window.background.busy or (window.held.shape if command.menu in ("Edit", "Frames") else "")
    if refusal and command.menu not in ("View", "Help") and name != "close":
        window.status.show_done(Done(refusal, "warn"), window.theme)
        return
    window.mark("looking")
    if name in STROKE_SETUP:
        window.desk.keys += 1 + command.key.count("+")
    window.act(actions[name])


def _actions(window: CorrectionWindow) -> dict[str, Action]:
    """Name -> action for every command but verdicts and undo."""
    desk, hand = window.desk, window.hand
    return {
        **{part.name: partial(window.choose, part.id) for part in PARTS},
        **{f"lock_{part.name}": partial(desk.toggle_lock, part.id) for part in PARTS},
        **{f"fade_{part.name}": partial(desk.fade, part.id) for part in PARTS},
        "undefined": partial(window.choose, UNDEFINED),
        "from_other": partial(desk.give_from, "other"),
        "from_before": partial(desk.give_from, "before"),
        **{tool: partial(window.set_tool, tool) for tool in TOOLS},
        **{name: partial(_toggle, hand, name) for name in SWITCHES},
        **{size: partial(hand.set_radius, px) for size, px in BRUSHES_PX.items()},
        "smaller": lambda: hand.set_radius(hand.radius_px / BRUSH_STEP),
        "larger": lambda: hand.set_radius(hand.radius_px * BRUSH_STEP),
        "cancel": partial(_cancel, window),
        "redo": desk.redo,
        **{name: partial(_at_pointer, window, name) for name in POINTED},
        "fill_holes": desk.fill_holes,
        "remove_islands": desk.remove_islands,
        "copy_previous": partial(_copy, window),
        "propagate": partial(_carry_over, window, 2),
        "carry": desk.toggle_carrying,
        "doubt": partial(_doubt, window),
        "next": partial(_step, window, 1),
        "back": partial(_step, window, -1),
        "go_to": lambda: window.panel.number.setFocus(),
        "order": partial(_next_order, window),
        "filter": partial(_next_filter, window),
        "colouring": partial(_next_colouring, window),
        "outlines": partial(_outlines, window),
        "tint": partial(_next_tint, window),
        "onion": partial(_switch, window, "onion"),
        "solo": partial(_switch, window, "alone"),
        "peek": lambda: window.peek(not window.peeking),
        "swap_views": window.panes.swap,
        "front_view": window.look_ahead,
        "theme": window.toggle_theme,
        "save": partial(_save, window),
        "export": partial(_export, window),
        "close": partial(_close, window),
        "help": window.toggle_help,
    }


class Judged:
    """Verdicts, each followed by the next frame that waits, and undo, which goes back to take one back."""

    def __init__(self, window: CorrectionWindow) -> None:
        self._window = window
        # The frame judged, the one that was opened then, and the number of its strokes at that moment.
        self._way: list[tuple[str, str, int]] = []

    def accept(self) -> Done | None:
        """Accept the frame or agree with the verdict that stands, and go on."""
        window = self._window
        if window.correction.read_only:
            return self._go_on(Done("Read-only"), False)
        return self._go_on(window.desk.accept(), window.desk.carrying)

    def reject(self) -> Done | None:
        """Open the dialog of reasons and reject the frame, or agree with a colleague's rejection; go on."""
        desk = self._window.desk
        if desk.rejected and self._window.correction.next_verdict(self._window.frame_id) == "agree":
            return self._go_on(desk.accept(), False)
        if not (reason := ask_reason(self._window)):
            return Done("Not rejected")
        return self._go_on(desk.reject(reason), False)

    def overrule(self) -> Done | None:
        """Accept a frame although it stands rejected, and go on."""
        window = self._window
        if done := window.desk.overrule():
            return self._go_on(done, window.desk.carrying)
        return Done(f"This frame is not rejected: {window.settings.key('accept')} accepts it", "warn")

    def undo(self) -> Done | None:
        """Take back the last stroke, or the verdict that opened this frame if nothing was done since."""
        window = self._window
        editor = window.desk.editor
        if self._way and editor and not window.desk.preview:
            judged, opened, strokes = self._way[-1]
            if opened == window.frame_id and len(editor.history.done) <= strokes:
                self._way.pop()
                window.open_frame(judged, window.desk.undo)
                return None
        return window.desk.undo()

    def _go_on(self, done: Done, carrying: bool) -> Done | None:
        window, judged = self._window, self._window.frame_id
        window.refresh_picture()
        following = window.walk.next_unfinished(judged)
        if following is None or following == judged:
            left = f". {window.walk.all_done()}" if following is None else ""
            return Done(f"{done.text}{left}", "good")

        def arrived() -> Done | None:
            editor = window.desk.editor
            if editor:
                self._way.append((judged, window.frame_id, len(editor.history.done)))
            untouched = window.correction.state(window.frame_id) == "auto"
            return _carry_over(window, 0) if carrying and untouched else None

        window.open_frame(following, arrived)
        return None


def _toggle(hand: object, name: str) -> None:
    setattr(hand, name, not getattr(hand, name))


def _switch(window: CorrectionWindow, name: str) -> Done | None:
    _toggle(window.desk, name)
    window.recolor()
    if name == "onion" and window.desk.onion and window.desk.before is None:
        return Done("There is no frame before this one", "warn")
    return None


def _at_pointer(window: CorrectionWindow, name: str) -> Done | None:
    if window.pointed() is not None:
        return window.at_pixel(name, window.under_pointer())
    _arm(window, name)
    return None


def _arm(window: CorrectionWindow, name: str) -> None:
    """Let the next click carry out a command."""
    window.cancel_stroke()
    window.hand.once = name
    window.refresh()


def _cancel(window: CorrectionWindow) -> Done | None:
    if window.key_page.isVisible():
        window.toggle_help()
        return None
    if window.cancel_stroke():
        return Done("Stroke cancelled")
    return window.desk.cancel()


def _copy(window: CorrectionWindow) -> Done | None:
    if (before := window.walk.before(window.frame_id)) is None:
        return Done("This is the first frame; there is none before it", "warn")
    _computed(window, "Copying the frame before…", window.desk.copied(before), window.desk.copy_previous)
    return None


def _carry_over(window: CorrectionWindow, keys: int) -> Done | None:
    then = partial(window.desk.propagate, keys=keys)
    _computed(window, "Carrying corrections over…", window.desk.carried(), then)
    return None


def _computed(window: CorrectionWindow, text: str, work: Callable[[], C], then: Callable[[C], Done]) -> None:
    """Compute labels beside the window, and apply them; show the reason where there are none."""

    def failed(error: CloudError) -> None:
        window.status.show_done(Done(str(error), "warn"), window.theme)

    window.busy(text, work, lambda computed: window.act(partial(then, computed)), failed)


def _doubt(window: CorrectionWindow) -> Done:
    done, doubt = window.desk.next_doubt()
    if doubt:
        window.show_place(doubt.pixels, doubt.middle)
    return done


def _step(window: CorrectionWindow, by: int) -> Done | None:
    if (frame_id := window.walk.beside(window.frame_id, by)) is None:
        return Done("That was the last frame" if by > 0 else "This is the first frame", "warn")
    window.open_frame(frame_id)
    return None


def _next_order(window: CorrectionWindow) -> Done | None:
    orders = list(ORDERS)
    order = orders[(orders.index(window.walk.order) + 1) % len(orders)]
    window.arrange(order, window.walk.filter)
    waiting = next((i for i in window.walk.frame_ids if window.walk.waits(i)), None)
    done = Done(f"Frames: {ORDERS[order].lower()}")
    if order == "review":
        done = Done(f"{len(window.walk.reasons)} frames of others to review")
    if order == "time" or waiting in (None, window.frame_id):
        return done
    window.open_frame(str(waiting), lambda: done)
    return None


def _next_filter(window: CorrectionWindow) -> Done:
    filters = list(FILTERS)
    kept = filters[(filters.index(window.walk.filter) + 1) % len(filters)]
    window.arrange(window.walk.order, kept)
    return Done(f"Frames shown: {FILTERS[kept].lower()}")


def _next_colouring(window: CorrectionWindow) -> None:
    look, there = window.pane.look, colourings(window.desk.scene)
    at = there.index(look.colouring) + 1 if look.colouring in there else 1
    window.set_look(window.pane, replace(look, colouring=there[at % len(there)]))


def _outlines(window: CorrectionWindow) -> Done | None:
    if refusal := _all_parts(window):
        return refusal
    window.set_look(window.pane, replace(window.pane.look, outlines=not window.pane.look.outlines))
    return None


def _all_parts(window: CorrectionWindow) -> Done | None:
    """Return a warning for a pane that shows parts alone, where outlines have no effect; None elsewhere."""
    if window.look(window.pane).colouring in colourings(window.desk.scene)[1:]:
        return None
    return Done(
        f"This view shows the parts themselves: {window.settings.key('colouring')} changes that", "warn"
    )


def _next_tint(window: CorrectionWindow) -> Done | None:
    if refusal := _all_parts(window):
        return refusal
    look = window.pane.look
    window.set_look(window.pane, replace(look, tint=TINTS[(TINTS.index(look.tint) + 1) % len(TINTS)]))
    return None


def _save(window: CorrectionWindow) -> Done:
    if window.desk.editor:
        window.correction.save(window.frame_id)
    return Done("Everything is saved", "good")


def _close(window: CorrectionWindow) -> None:
    window.close()


def _export(window: CorrectionWindow) -> Done | None:
    # Its import takes half a second.
    from annotate.exchange.formats import FORMATS, export_labels

    if not (chosen := ask_export(window, list(FORMATS))):
        return Done("Not exported")
    name, folder = chosen
    _save(window)

    def work() -> tuple[str, ...]:
        return export_labels(window.correction.labels, folder, name, lambda _: None)

    def then(lost: tuple[str, ...]) -> None:
        left_out = f"; it cannot carry {' and '.join(lost)}" if lost else ""
        window.act(lambda: Done(f"Exported to {folder}{left_out}", "good"))

    window.busy(f"Exporting to {folder.name}…", work, then)
    return None
