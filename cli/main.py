"""The ``annotate-cloud`` command: all verbs, and the place that prints errors and exits."""

import errno
import os
import sys
from functools import partial

import typer

from annotate.compiler_notice import announce_compiling
from cli import benchmark, demo, installation, scheme
from cli.remedies import RUNNING, options_of, remedied
from cli.verbs import (
    calibration,
    conversion,
    evaluation,
    exchange,
    info,
    learning,
    live,
    models,
    motion,
    recording,
    rigs,
    simulation,
    suit_training,
    synthesis,
    training,
)
from cli.verbs.labels import correction, labelling, palette, prediction, trial
from sensors.errors import CloudError, one_line
from sensors.interrupt import interruptible

app = typer.Typer(
    name="annotate-cloud",
    help="Label human depth images with body parts, and measure networks against the labels.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(palette.suit_app, name="suit", rich_help_panel="Labels")
app.add_typer(scheme.app, name="scheme", rich_help_panel="Labels")
app.add_typer(models.app, name="models", rich_help_panel="Labels")
app.add_typer(synthesis.app, name="synth", rich_help_panel="Synthetic people")
app.add_typer(benchmark.app, name="benchmark", rich_help_panel="Networks and results")
VERBS = {
    "Getting started": (demo.demo, trial.try_, installation.doctor, installation.compile_),
    "Recordings": (
        *(simulation.simulate, recording.devices, rigs.rig, recording.record, live.live),
        *(recording.repair, calibration.calibrate, exchange.import_, recording.strip),
        *(info.info, info.validate),
    ),
    "Labels": (
        *(labelling.label, suit_training.train_labels, correction.fix, learning.learn),
        *(evaluation.diff, conversion.convert, exchange.export),
    ),
    "Synthetic people": (motion.solve,),
    "Networks and results": (
        *(training.train, learning.adapt, prediction.predict),
        *(evaluation.evaluate, evaluation.compare, evaluation.report),
    ),
}
"""Verbs under the headings of ``--help``, in the order of first use."""

for heading, verbs in VERBS.items():
    for verb in verbs:
        app.command(verb.__name__.strip("_").replace("_", "-"), rich_help_panel=heading)(verb)

CONTINUED = (
    *("label", "predict", "try", "train", "learn", "adapt"),
    *("synth generate", "benchmark itop", "benchmark joints"),
)
"""Verbs that continue an interrupted run when the same command is given again."""


def main() -> None:
    """Run the command. Exit codes: 0 done, 1 an error in one line, 2 wrong usage, 3 done in part."""
    # Child processes import nothing from the current folder, because it may be another person's.
    os.environ["PYTHONSAFEPATH"] = "1"
    # OpenCV's warnings about damaged images would add lines to the error that names the file.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
    RUNNING.set(partial(options_of, app, sys.argv[1:]))
    announce_compiling()
    try:
        with interruptible():
            app()
    except CloudError as error:
        _fail(remedied(error))
    except KeyboardInterrupt:
        _fail(_interrupted(sys.argv[1:]), 130)
    except SystemExit as end:
        # Typer turns Ctrl-C into an exit without a message.
        if end.code == 130:
            _fail(_interrupted(sys.argv[1:]), 130)
        raise
    except BrokenPipeError:
        # The reader of the output has ended.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except RuntimeError as error:
        # Until Python 3.12, pathlib raises it for links that lead back to themselves.
        if "Symlink loop" not in str(error):
            raise
        _fail(f"{error}; check the path")
    except OSError as error:
        where = f" ({error.filename})" if error.filename else ""
        remedy = {
            errno.ENOSPC: "free some space and run the same command again",
            errno.EACCES: "check the permissions",
            errno.EROFS: "choose a folder that can be written to",
        }.get(error.errno or 0, "check the path")
        _fail(f"{error.strerror or error}{where}; {remedy}")


def _interrupted(words: list[str]) -> str:
    """Return the message for an interrupted command, given its arguments."""
    if " ".join(words[:1]) in CONTINUED or " ".join(words[:2]) in CONTINUED:
        kept = ", without --overwrite," if "--overwrite" in words else ""
        return f"interrupted; run the same command again{kept} to continue"
    return "interrupted; the same command begins anew"


def _fail(message: str, code: int = 1) -> None:
    print(f"annotate-cloud: {' '.join(one_line(message).split())}", file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    main()
