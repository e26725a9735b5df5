"""What each key and button does in the window: the names of ``keys.BINDINGS`` and their actions."""

from collections.abc import Callable
from functools import partial

from PySide6.QtGui import QKeySequence, QShortcut

from annotate.gui.bars import SWITCHES
from annotate.gui.dialogs import ask_reason
from annotate.gui.drawing import TOOLS
from annotate.gui.outcome import Done
from annotate.gui.window import CorrectionWindow
from annotate.parts import PARTS, UNDEFINED

BRUSHES_PX = {"small": 9.0, "medium": 18.0, "large": 30.0}
"""Radii of the brush in logical pixels of the screen. Chosen by eye."""
STROKE_SETUP = {*(part.name for part in PARTS), "undefined", "pick", *SWITCHES, *BRUSHES_PX, *TOOLS}
"""Keys that count towards the price of the stroke that follows them."""


def bind(window: CorrectionWindow) -> None:
    """Connect the keys and buttons of a window with their actions."""
    actions = _actions(window)

    def run(name: str) -> None:
        window.mark("looking")
        if name in STROKE_SETUP:
            window.desk.keys += 1 + window.settings.key(name).count("+")
        window.act(actions[name])

    for binding in window.settings.bindings:
        QShortcut(QKeySequence(binding.key), window, partial(run, binding.name))
    for part in PARTS:
        key = window.settings.key(part.name)
        if "+" not in key:
            QShortcut(QKeySequence(f"Shift+{key}"), window, partial(window.lock, part.id))
            QShortcut(QKeySequence(f"Alt+{key}"), window, partial(window.fade, part.id))
    for view in window.views:
        view.pointing.sampled.connect(partial(run, "pick"))
    window.tools.requested.connect(run)
    window.header.requested.connect(run)


def _actions(window: CorrectionWindow) -> dict[str, Callable[[], Done | None]]:
    """Name -> action for every binding."""
    desk, walk, point = window.desk, window.walk, window.under_pointer
    return {
        **{part.name: partial(window.choose, part.id) for part in PARTS},
        "undefined": partial(window.choose, UNDEFINED),
        "pick": partial(_pick, window),
        **{tool: partial(window.set_tool, tool) for tool in TOOLS},
        **{name: partial(window.toggle, name) for name in SWITCHES},
        **{size: partial(window.hand.set_radius, px) for size, px in BRUSHES_PX.items()},
        "solo": partial(_solo, window),
        "cancel": partial(_cancel, window),
        "undo": desk.undo,
        "redo": desk.redo,
        "swap": lambda: desk.swap(point()),
        "neighbour": lambda: desk.to_neighbour(point()),
        "fill_holes": desk.fill_holes,
        "remove_islands": desk.remove_islands,
        "merge": lambda: desk.merge(point()),
        "copy_previous": lambda: desk.copy_previous(walk.before(window.frame_id)),
        "propagate": lambda: desk.propagate(walk.corrected_near(window.frame_id)),
        "carry": desk.toggle_carrying,
        "accept": partial(_accept, window),
        "reject": partial(_reject, window),
        "next": partial(_step, window, 1),
        "back": partial(_step, window, -1),
        "save": partial(_save, window),
        "order": window.reorder,
        "colouring": lambda: window.set_colouring(desk.next_colouring()),
        "front_view": window.look_ahead,
        "theme": window.toggle_theme,
        "help": window.toggle_help,
    }


def _pick(window: CorrectionWindow) -> Done:
    done = window.desk.pick(window.under_pointer())
    window.choose(window.desk.part)
    return done


def _solo(window: CorrectionWindow) -> None:
    window.desk.alone = not window.desk.alone
    window.recolor()


def _cancel(window: CorrectionWindow) -> Done | None:
    if window.key_page.isVisible():
        window.toggle_help()
        return None
    if window.cancel_stroke():
        return Done("Stroke cancelled")
    return window.desk.cancel()


def _accept(window: CorrectionWindow) -> Done | None:
    done = window.desk.accept()
    window.strip.frames.refresh(window.frame_id)
    if not window.step(1):
        return Done(f"{done.text}: that was the last frame", "good")
    if not window.desk.carrying:
        return None
    return window.desk.carry(window.walk.corrected_near(window.frame_id))


def _reject(window: CorrectionWindow) -> Done | None:
    if not (reason := ask_reason(window)):
        return Done("Not rejected")
    done = window.desk.reject(reason)
    window.strip.frames.refresh(window.frame_id)
    return None if window.step(1) else done


def _save(window: CorrectionWindow) -> Done:
    if window.desk.editor:
        window.correction.save(window.frame_id)
    return Done("Everything is saved", "good")


def _step(window: CorrectionWindow, by: int) -> Done | None:
    if window.step(by):
        return None
    return Done("That was the last frame" if by > 0 else "This is the first frame", "warn")
