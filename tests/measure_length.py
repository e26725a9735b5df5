"""Does a long session cost more? ``python -m tests.measure_length SESSION.mcap FRAMES FOLDER``.

Makes a session of so many frames by repeating a recorded one, labels it, prints for every tenth seconds a
frame and the memory held. A broken run goes on where it stopped.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from annotate.label import label_source
from annotate.suit.palette import load_suit
from sensors.frame import FRAME_PERIOD_NS
from sensors.replay import Session
from sensors.session import SessionWriter
from synth.simulate import suit_path
from tests.measure_recording import resident_mb

TENTHS = 10


def repeated(path: Path, out: Path, frames: int) -> Session:
    """A session that shows the frames of another again and again, with time going on."""
    if not out.exists():
        short = Session(path)
        with SessionWriter(out, short.calibration, short.name) as writer:
            for index in range(frames):
                frame = short.frame(index % len(short))
                writer.write(replace(frame, index=index, stamp_ns=index * 15 * FRAME_PERIOD_NS))
    return Session(out)


def main() -> None:
    """Label and print."""
    path, frames, folder = Path(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
    folder.mkdir(parents=True, exist_ok=True)
    session = repeated(path, folder / f"long-{frames}.mcap", frames)
    opened_mb = resident_mb()
    print(f"{len(session)} frames; opened: {opened_mb:.0f} MB", flush=True)
    seconds: list[float] = []
    last = time.monotonic()

    def advance(n: int) -> None:
        nonlocal last
        now = time.monotonic()
        seconds.extend([(now - last) / n] * n)
        last = now
        if len(seconds) % (frames // TENTHS) == 0:
            tenth = seconds[-(frames // TENTHS) :]
            print(
                f"{len(seconds)}: median {np.median(tenth):.4f} s a frame, mean {np.mean(tenth):.4f}, "
                f"{resident_mb():.0f} MB",
                flush=True,
            )

    label_source(session, load_suit(suit_path(path)), folder / "labels", advance)


if __name__ == "__main__":
    main()
