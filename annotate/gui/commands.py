"""Commands of the window: the actions behind the names of ``keys.COMMANDS``, their menus and keys."""

from collections.abc import Callable, Sequence, Set
from dataclasses import replace
from functools import partial
from typing import TypeVar

from PySide6.QtGui import QAction, QKeySequence

from annotate.gui.background import Task
from annotate.gui.held_keys import KeyRepeatFilter
from annotate.gui.learning import LearnCommand, Learner
from annotate.gui.panels.bars import CHANGING, SWITCHES
from annotate.gui.state.drawing import TOOLS
from annotate.gui.state.frame_order import FILTERS, ORDERS
from annotate.gui.state.keys import Command, key_of
from annotate.gui.state.outcome import Outcome
from annotate.gui.state.point_colors import TINTS, Look, colourings
from annotate.gui.verdicts import Verdicts
from annotate.gui.widgets.dialogs import ask_export
from annotate.gui.widgets.theme import DARK, LIGHT
from annotate.gui.window import CorrectionWindow

T = TypeVar("T")
Action = Callable[[], Outcome | None]
BRUSHES_PX = {"small": 9.0, "medium": 18.0, "large": 30.0}  # radii in logical pixels; untuned
BRUSH_STEP = 1.15  # factor of one step of the radius; untuned
STROKE_SETUP = {"pick", "from_other", "from_before", *SWITCHES, *BRUSHES_PX, *TOOLS}
"""Commands whose keys count for the stroke that follows, besides those that choose a part."""
POINTED = ("swap", "neighbour", "merge", "pick")
"""Commands that need a place: of the pointer, or else of the next click."""
MENUS = {
    "File": "&File",
    "Edit": "Ed&it",
    "Parts": "&Parts",
    "Tools": "&Tools",
    "Frames": "F&rames",
    "View": "&View",
    "Help": "&Help",
}
SUBMENUS = {"Lock": "Parts", "Fade": "Parts"}
CHECKABLE = {*TOOLS, *SWITCHES, "onion", "witness", "solo", "peek", "from_other", "from_before", "help"}


def bind(window: CorrectionWindow, learn: LearnCommand | None = None) -> None:
    """Add the commands to a window: menus, keys, and the actions of its buttons."""
    KeyRepeatFilter(window).repeated.connect(window.held.repeated)
    actions = _actions(window, Verdicts(window), Learner(window, learn))
    run = partial(_run, window, actions)
    keys = {key for command in window.settings.commands for key in command.keys}
    menus = {
        name: window.panels.header.menus.addMenu(_menu_title(title, keys)) for name, title in MENUS.items()
    }
    menus |= {name: menus[above].addMenu(f"{name} a part") for name, above in SUBMENUS.items()}
    for command in window.settings.commands:
        action = window.actions_by_name[command.name] = _made(window, command, partial(run, command.name))
        menus[command.menu].addAction(action)
        action.setEnabled(not (window.correction.read_only and command.name in CHANGING))
    for menu in menus.values():
        menu.aboutToShow.connect(partial(_check, window))
    for view in window.views:
        view.layer.sampled.connect(partial(run, "pick"))
    window.requested.connect(lambda name: _arm(window, name) if name in POINTED else run(name))
    window.panels.palette_.locked.connect(lambda part: window.act(partial(window.edits.toggle_lock, part)))
    window.panels.palette_.faded.connect(lambda part: window.act(partial(window.edits.fade, part)))
    window.panels.key_page.closed.connect(partial(_toggle_help, window))
    window.refresh()


def _menu_title(title: str, keys: Set[str]) -> str:
    """Return a menu's title, without its mnemonic ("&") if a command has that key with Alt."""
    letter = title[title.index("&") + 1].upper()
    return title.replace("&", "") if f"Alt+{letter}" in keys else title


def _made(window: CorrectionWindow, command: Command, run: Callable[..., None]) -> QAction:
    action = QAction(command.title, window)
    action.setCheckable(command.name in CHECKABLE)
    action.setToolTip(command.hint or command.title)
    action.setStatusTip(command.hint)
    action.setAutoRepeat(command.repeats)
    if command.name == "peek":
        # Not a shortcut, because peeking lasts while the key is held: see ``HeldKeys``.
        action.setText(f"{command.title}\t{command.key}")
        window.held.peek_key = int(key_of(command.key))
    else:
        action.setShortcuts([QKeySequence(key) for key in command.keys])
    action.triggered.connect(run)
    window.addAction(action)
    return action


def _check(window: CorrectionWindow) -> None:
    """Update the check marks of the menu entries that can be on or off."""
    options, display = window.options, window.edits.display
    on = {options.tool, *(name for name in SWITCHES if getattr(options, name)), f"from_{window.edits.giver}"}
    states = {
        "onion": display.onion,
        "witness": display.witness,
        "solo": display.alone,
        "peek": window.views.peeking,
    }
    on |= {name for name, state in states.items() if state}
    for name in CHECKABLE:
        window.actions_by_name[name].setChecked(name in on)


def _run(window: CorrectionWindow, actions: dict[str, Action], name: str, *_: object) -> None:
    command = window.settings.command(name)
    if name == "undo" and (done := window.held.remove_corner()):
        window.say(done)
        return
    refusal = window.background.busy or (window.held.shape if command.menu in ("Edit", "Frames") else "")
    if refusal and command.menu not in ("View", "Help") and name != "close":
        window.say(Outcome(refusal, "warn"))
        return
    window.mark("looking")
    if name in STROKE_SETUP or (command.part is not None and command.menu == "Parts"):
        window.edits.keys += 1 + command.key.count("+")
    window.act(actions[name])


def _actions(window: CorrectionWindow, verdicts: Verdicts, learner: Learner) -> dict[str, Action]:
    """Return the action of every command by name."""
    edits, options = window.edits, window.options
    of_part = {"Parts": window.choose, "Lock": edits.toggle_lock, "Fade": edits.fade}
    return {
        **{c.name: partial(of_part[c.menu], c.part) for c in window.settings.commands if c.part is not None},
        "from_other": partial(edits.give_from, "other"),
        "from_before": partial(edits.give_from, "before"),
        **{tool: partial(window.set_tool, tool) for tool in TOOLS},
        **{name: partial(_toggle, options, name) for name in SWITCHES},
        **{size: partial(options.set_radius, px) for size, px in BRUSHES_PX.items()},
        "smaller": lambda: options.set_radius(options.radius_px / BRUSH_STEP),
        "larger": lambda: options.set_radius(options.radius_px * BRUSH_STEP),
        "cancel": partial(_cancel, window),
        "undo": verdicts.undo,
        "redo": edits.redo,
        **{name: partial(_at_pointer, window, name) for name in POINTED},
        "fill_holes": edits.fill_holes,
        "remove_islands": edits.remove_islands,
        "copy_previous": edits.copy_previous,
        "accept": verdicts.accept,
        "reject": verdicts.reject,
        "overrule": verdicts.overrule,
        "doubt": partial(_doubt, window),
        "next": partial(_step, window, 1),
        "back": partial(_step, window, -1),
        "learn": learner.learn,
        "stop_learning": learner.stop_now,
        "unlearn": learner.unlearn,
        "go_to": lambda: window.panels.progress.number.setFocus(),
        "order": partial(_next_order, window),
        "filter": partial(_next_filter, window),
        "colouring": partial(_next_colouring, window),
        "outlines": partial(_over_colouring, window, lambda look: replace(look, outlines=not look.outlines)),
        "tint": partial(_over_colouring, window, lambda look: replace(look, tint=_after(TINTS, look.tint))),
        "onion": partial(_switch, window, "onion"),
        "witness": partial(_switch, window, "witness"),
        "solo": partial(_switch, window, "alone"),
        "peek": lambda: window.views.peek(not window.views.peeking),
        "swap_views": window.panels.panes.swap,
        "front_view": partial(_front_view, window),
        "theme": lambda: window.show_theme(LIGHT if window.theme is DARK else DARK),
        "save": partial(_save, window),
        "export": partial(_export, window),
        "close": partial(_close, window),
        "help": partial(_toggle_help, window),
    }


def _after(values: Sequence[T], value: T) -> T:
    """Return the value that follows ``value``; the first value follows the last."""
    return values[(values.index(value) + 1) % len(values)]


def _toggle(switches: object, name: str) -> None:
    setattr(switches, name, not getattr(switches, name))


def _switch(window: CorrectionWindow, name: str) -> Outcome | None:
    _toggle(window.edits.display, name)
    window.views.recolor()
    if name == "onion" and window.edits.display.onion and window.edits.frame.before is None:
        return Outcome("No frame lies before this one", "warn")
    if name == "witness" and window.edits.display.witness and not window.edits.frame.scene.witnessed:
        return Outcome("No colour network labelled this frame: label --by colour does", "warn")
    return None


def _at_pointer(window: CorrectionWindow, name: str) -> Outcome | None:
    if window.views.pointed() is not None:
        return window.at_pixel(name, window.views.under_pointer())
    _arm(window, name)
    return None


def _arm(window: CorrectionWindow, name: str) -> None:
    """Make a command wait for the next click, which gives the place to act on."""
    window.views.cancel()
    window.options.once = name
    window.refresh()


def _cancel(window: CorrectionWindow) -> Outcome | None:
    if window.panels.key_page.isVisible():
        _toggle_help(window)
        return None
    return Outcome("Stroke cancelled") if window.views.cancel() else window.edits.cancel()


def _toggle_help(window: CorrectionWindow) -> None:
    """Show or hide the page of all keys; while it is shown, other commands are disabled."""
    page = window.panels.key_page
    shown = not page.isVisible()
    page.setVisible(shown)
    page.raise_()
    for name, action in window.actions_by_name.items():
        if name not in ("help", "cancel"):
            action.setEnabled(not shown and not (window.correction.read_only and name in CHANGING))


def _doubt(window: CorrectionWindow) -> Outcome:
    done, doubt = window.edits.next_doubt()
    if doubt:
        window.views.show_place(doubt.pixels, doubt.middle)
    return done


def _step(window: CorrectionWindow, by: int) -> Outcome | None:
    if (frame_id := window.frames.beside(window.frame_id, by)) is None:
        return Outcome("That was the last frame" if by > 0 else "This is the first frame", "warn")
    window.open_frame(frame_id)
    return None


def _next_order(window: CorrectionWindow) -> Outcome | None:
    frames = window.frames
    order = _after(tuple(ORDERS), frames.order)
    window.arrange(order, frames.filter)
    waiting = next((i for i in frames.frame_ids if frames.waits(i)), None)
    done = Outcome(f"Frames: {ORDERS[order].lower()}")
    if order == "review":
        done = Outcome(f"{len(frames.reasons)} frames of others to review")
    if order == "time" or waiting in (None, window.frame_id):
        return done
    window.open_frame(str(waiting), lambda: done)
    return None


def _next_filter(window: CorrectionWindow) -> Outcome:
    kept = _after(tuple(FILTERS), window.frames.filter)
    window.arrange(window.frames.order, kept)
    return Outcome(f"Frames shown: {FILTERS[kept].lower()}")


def _next_colouring(window: CorrectionWindow) -> None:
    view, there = window.views.last, colourings(window.edits.frame.scene)
    shown = view.look.colouring if view.look.colouring in there else there[0]
    window.views.set_look(view, replace(view.look, colouring=_after(there, shown)))


def _over_colouring(window: CorrectionWindow, changed: Callable[[Look], Look]) -> Outcome | None:
    """Change the look by ``changed``: outlines or tint. Refuse in a view coloured by parts, where both have
    no effect.
    """
    view = window.views.last
    if window.views.look(view).colouring not in colourings(window.edits.frame.scene)[1:]:
        key = window.settings.key("colouring")
        return Outcome(f"This view shows the parts themselves: {key} changes that", "warn")
    window.views.set_look(view, changed(view.look))
    return None


def _front_view(window: CorrectionWindow) -> None:
    """Show the person from the depth camera's viewpoint."""
    window.views.cloud.look_ahead()
    window.views.depth.fit()


def _save(window: CorrectionWindow) -> Outcome:
    if window.edits.frame.editor:
        window.correction.save(window.frame_id)
    return Outcome("Everything is saved", "good")


def _close(window: CorrectionWindow) -> None:
    window.close()


def _export(window: CorrectionWindow) -> Outcome | None:
    # Its import takes half a second.
    from annotate.exchange.formats import FORMATS, export_labels
    from annotate.labelset.nameless import NamelessLabelSet

    if not (chosen := ask_export(window, {name: one.title for name, one in FORMATS.items()})):
        return Outcome("Not exported")
    name, folder = chosen
    _save(window)

    def work() -> tuple[str, ...]:
        labels = NamelessLabelSet.open(window.correction.labels.path)
        return export_labels(labels, folder, name, lambda _: None)

    def then(lost: tuple[str, ...]) -> None:
        left_out = f"; it cannot carry {' and '.join(lost)}" if lost else ""
        window.say(Outcome(f"Exported to {folder}{left_out}", "good"))

    window.busy(Task(f"Exporting to {folder.name}…", work, then))
    return None
