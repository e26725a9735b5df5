"""Recordings ended by signals: ``python -m tools.measure.ended_recordings [COUNT [FOLDER]]``.

Each recording runs in a process of its own and is ended by SIGINT or SIGTERM at a random moment. In turn: the
command ``record``, the command ``live --record`` (labelling replaced, since it is not measured), and a
``LiveRig`` of a depth camera that is never late. The first two have a virtual Kinect v2. Meanwhile another
process keeps a core busy. Then every session is opened: a recording is *refused* if ``Session`` refuses it,
*cut off* if it is not whole, and *empty* if the signal came before the first depth image: no file is left.
"""

import multiprocessing
import os
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import ClassVar

import numpy as np

import cli.live_view
import cli.main
import cli.rig_devices
from annotate.live.live_frame import Labelling
from annotate.segmentation.suit_network import shipped_suit_network
from sensors.calibration_files.kinect2_factory import KINECT2_DEPTH
from sensors.device.protocol import DepthImage, DeviceReading
from sensors.errors import CloudError
from sensors.interrupt import ended_by_signals
from sensors.recording.live_rig import LiveRig
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.reader import Session
from tests.helpers.swinging_ball import swinging_ball

WAYS = ("record", "live", "rig")
LATEST_S = 1.0
"""Largest delay of the signal after the file has appeared, in seconds."""


class Camera:
    """A depth camera of 512 x 424 at 30 images a second that hardly compress."""

    address, serial, calibration = "fast:1", "1", RigCalibration(KINECT2_DEPTH)
    rates_hz: ClassVar = {"depth": 30.0}

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        self._images = [1000 + rng.integers(0, 40, (424, 512), np.uint16) for _ in range(4)]
        self._number, self._start_s = 0, time.monotonic()

    def start(self) -> None:
        pass

    def close(self) -> None:
        pass

    def read(self, timeout_s: float) -> DeviceReading:
        self._number += 1
        time.sleep(max(0.0, self._start_s + self._number / 30 - time.monotonic()))
        image = DepthImage(self._images[self._number % 4])
        return DeviceReading(self._number * 33_333_333, time.monotonic_ns(), image)


class Shown:
    """Images of virtual cameras, without a renderer."""

    calibration = RigCalibration(KINECT2_DEPTH)

    def __init__(self, plate: object = None) -> None:
        pass

    def __iter__(self):  # type: ignore[no-untyped-def]
        return iter(swinging_ball())


def nothing_labelled(*_: object) -> Labelling:
    def fail(*_: object) -> None:
        raise CloudError("nobody is in view")

    return Labelling(fail, fail)  # type: ignore[arg-type]


def record(way: str, path: Path) -> None:
    """Record until a signal comes."""
    if way == "rig":
        rig = LiveRig("fast", [Camera()], Camera.calibration, {}, lambda address: Camera())
        with ended_by_signals() as ending:
            rig.record(path)
            rig.start()
            while not ending.asked:
                time.sleep(0.01)
            rig.close()
        return
    verb = ["record", str(path)] if way == "record" else ["live", "--no-window", "--record", str(path)]
    sys.argv = ["annotate-cloud", *verb, "--device", "virtual:kinect2"]
    cli.main.main()


def in_child(way: str, path: Path) -> int:
    """Start a recording in a process of its own; return its number."""
    child = os.fork()
    if child:
        return child
    code = 99
    try:
        for stream in (1, 2):
            os.dup2(os.open(path.with_suffix(f".said{stream}"), os.O_CREAT | os.O_WRONLY), stream)
        record(way, path)
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(code)


def ended(way: str, path: Path, rng: np.random.Generator) -> tuple[str, str]:
    """Return the outcome of one recording, and its output on stderr."""
    child, number = in_child(way, path), rng.choice([signal.SIGINT, signal.SIGTERM])
    partial, status = path.with_name(path.name + ".partial"), 0
    while not partial.exists():
        gone, status = os.waitpid(child, os.WNOHANG)
        if gone:
            return "never begun", path.with_suffix(".said2").read_text()[-1000:]
        time.sleep(0.002)
    time.sleep(rng.uniform(0, LATEST_S))
    os.kill(child, number)
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    said = path.with_suffix(".said2").read_text()[-300:].strip()
    try:
        session = Session(path)
    except CloudError as error:
        if not path.exists() and not partial.exists():
            return "empty", said
        return "refused", f"{error} | {said}"
    if session.truncated or partial.exists():
        return "cut off", said
    return ("whole" if code == 0 else f"exit {code}"), said


def busy() -> None:
    while True:
        sum(range(100_000))


def main(count: int, folder: Path) -> None:
    # Loaded before anything forks.
    swinging_ball()
    shipped_suit_network()
    cli.rig_devices.Shown = Shown  # type: ignore[assignment,misc]
    cli.live_view.labelling_by = nothing_labelled
    load = multiprocessing.get_context("fork").Process(target=busy, daemon=True)
    load.start()
    outcomes, rng = {way: Counter[str]() for way in WAYS}, np.random.default_rng(0)
    try:
        for number in range(count):
            way = WAYS[number % 3]
            path = folder / f"{number}.mcap"
            outcome, said = ended(way, path, rng)
            outcomes[way][outcome] += 1
            if outcome != "whole":
                print(f"{number}, {way}: {outcome}: {said}", flush=True)
            for file in folder.glob(f"{number}.*"):
                file.unlink()
            if number % 20 == 19:
                print(f"{number + 1}: {outcomes}", flush=True)
    finally:
        load.terminate()
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    for way, found in outcomes.items():
        print(f"{way}: {sum(found.values())} recordings, " + ", ".join(f"{n} {o}" for o, n in found.items()))


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    if len(sys.argv) > 2:
        main(count, Path(sys.argv[2]))
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(count, Path(temporary))
