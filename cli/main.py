"""The ``annotate-cloud`` command: mounts all verbs; the one place that prints errors and exits."""

import errno
import os
import sys

import typer

from cli import (
    calibration,
    data,
    demo,
    devices,
    doctor,
    evaluation,
    exchange,
    fix,
    labelling,
    motion,
    prediction,
    recording,
    reporting,
    synthesis,
    training,
)
from sensors.errors import CloudError

app = typer.Typer(
    name="annotate-cloud",
    help="Annotate human depth images with body parts, and measure networks against the labels.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(demo.demo)
app.command()(data.simulate)
app.command("import")(exchange.import_)
app.command()(exchange.export)
app.command()(data.info)
app.command()(data.validate)
app.command()(doctor.doctor)
app.command()(devices.devices)
app.command()(recording.record)
app.command()(labelling.label)
app.add_typer(labelling.suit_app, name="suit")
app.command()(labelling.diff)
app.command()(fix.fix)
app.add_typer(synthesis.app, name="synth")
app.command()(motion.solve)
app.command()(calibration.calibrate)
app.command()(training.train)
app.command()(prediction.predict)
app.command()(evaluation.evaluate)
app.command()(evaluation.compare)
app.command()(reporting.report)

INTERRUPTED = "interrupted; give the same command again, without --overwrite, to go on"


def main() -> None:
    """Run the command; exit 0 done, 1 a user's error in one line, 2 wrong usage, 3 done in part."""
    try:
        app()
    except CloudError as error:
        _fail(str(error))
    except KeyboardInterrupt:
        _fail(INTERRUPTED, 130)
    except SystemExit as end:
        # Typer makes a silent exit of Ctrl-C.
        if end.code == 130:
            _fail(INTERRUPTED, 130)
        raise
    except BrokenPipeError:
        # The reader of our output has gone: nothing is left to say, and nowhere to say it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:
        where = f" ({error.filename})" if error.filename else ""
        remedy = {
            errno.ENOSPC: "free some space and run the same command again",
            errno.EACCES: "check the permissions",
            errno.EROFS: "choose a place that can be written to",
        }.get(error.errno or 0, "check the path")
        _fail(f"{error.strerror or error}{where}; {remedy}")


def _fail(message: str, code: int = 1) -> None:
    print(f"annotate-cloud: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    main()
