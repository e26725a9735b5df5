"""The annotate-cloud command."""

import signal
import sys

from sensors.interrupt import interruptible


def command() -> None:
    """Run the command line. Ctrl-C gives one line at any time, also while modules are imported."""
    try:
        with interruptible():
            from cli.main import main

            main()
    except KeyboardInterrupt:
        print("annotate-cloud: interrupted; the same command begins anew", file=sys.stderr)
        sys.exit(130)
    finally:
        # Nothing is left to write: Python's own end must not print a traceback.
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
