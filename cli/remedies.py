"""Options of the running verb that mend a fault, added to the errors and notes of the libraries."""

from collections.abc import Callable, Sequence
from contextvars import ContextVar

from typer import Typer
from typer.core import TyperGroup
from typer.main import get_command

from sensors.errors import CloudError, Note, Setting

RUNNING = ContextVar[Callable[[], frozenset[str]]](
    "function that returns the running verb's options", default=frozenset
)

_RECORDING = (
    *(Setting.INTRINSICS, Setting.DEPTH_UNIT, Setting.TURN, Setting.MIRROR),
    *(Setting.AXES, Setting.TOPIC, Setting.RATE),
)
_ELSEWHERE = {
    **dict.fromkeys(_RECORDING, "import"),
    Setting.UP: "solve",
    Setting.MARKERSET: "solve",
    Setting.TAKE: "synth film",
}
"""Verb with the option, for verbs that read the same files without the option."""


def options_of(app: Typer, words: Sequence[str]) -> frozenset[str]:
    """Return the options of the verb that the words of a command line name, of all verbs of ``app``."""
    command = get_command(app)
    for word in words:
        if not isinstance(command, TyperGroup):
            break
        command = command.commands.get(word, command)
    return frozenset(option for one in command.params for option in one.opts)


def remedied(said: str | Exception) -> str:
    """Return an error or a remark with the options of the running verb that change its cause."""
    settings = said.settings if isinstance(said, Note | CloudError) else ()
    named = [option for setting in settings if (option := _option(setting))]
    if Setting.OVERWRITE in settings:
        return " or pass ".join([str(said), *named])
    return f"{said} ({', '.join(named)})" if named else str(said)


def _option(setting: Setting) -> str:
    """Return the option for a setting, of the running verb or after the verb that has it; "" = none."""
    options, option = RUNNING.get()(), f"--{setting.value}"
    if option in options:
        return option
    if setting is Setting.INTRINSICS and "--camera" in options:
        return "--camera"
    verb = _ELSEWHERE.get(setting)
    return f"{verb} {option}" if options and verb else ""
