"""One line on stderr when numba compiles kernels: at their first use on a machine, for up to a minute."""

import sys
from collections.abc import Callable, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

EVENTS = "numba.core.event"
LINE = "compiling kernels, once on this machine; this takes up to a minute"


class _Notice(MetaPathFinder):
    """Line that is due once, and finder that listens to numba's compiler.

    It listens once another module imports numba, because that import takes a second. claim: function that
    claims the line for this process; None = no line is due.
    """

    claim: Callable[[], bool] | None = None
    listens = False

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return numba's module of events, which then calls ``_listen``."""
        if name != EVENTS:
            return None
        sys.meta_path.remove(self)
        spec = find_spec(name)
        if spec is not None and spec.loader is not None:
            run = spec.loader.exec_module
            # The module is complete before it is listened to.
            spec.loader.exec_module = lambda module: (run(module), self.listen(module))  # type: ignore
        return spec

    def listen(self, events: ModuleType) -> None:
        """Call ``announce`` at every compilation."""
        actions = {"on_start": lambda *_: self.announce(), "on_end": lambda *_: None}
        events.register("numba:compile", type("Compiling", (events.Listener,), actions)())
        self.listens = True

    def announce(self) -> None:
        """Print the line if it is due."""
        claim, self.claim = self.claim, None
        if claim is not None and claim():
            sys.stderr.write(LINE + "\n")
            sys.stderr.flush()


_NOTICE = _Notice()


def announce_compiling(claim: Callable[[], bool] = lambda: True) -> None:
    """Print one line when this process next compiles a kernel; kernels in numba's cache print nothing.

    claim: function that is called at that time; the line is printed if it returns True.
    """
    _NOTICE.claim = claim
    if _NOTICE.listens or _NOTICE in sys.meta_path:
        return
    if EVENTS in sys.modules:
        _NOTICE.listen(sys.modules[EVENTS])
    else:
        sys.meta_path.insert(0, _NOTICE)


def is_due() -> bool:
    """Return whether the next compilation prints the line."""
    return _NOTICE.claim is not None
