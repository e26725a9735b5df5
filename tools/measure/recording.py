"""Recording three virtual devices: ``python -m tools.measure.recording [SECONDS] [KILLS]``.

Prints drops, the share of a core, memory at the start and the end; then kills recordings with -9 at random
moments and prints what each lost.
"""

import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np

from cli.rig_devices import Shown
from sensors.device.protocol import Device
from sensors.recording.live_rig import LiveRig
from sensors.recording.open_device import open_device
from sensors.session.reader import Session

DEVICES = ("virtual:kinect2", "virtual:optris-direct", "virtual:pyrometer?family=ct")


def resident_mb() -> float:
    """Memory that this process holds now, in megabytes."""
    found = re.search(r"VmRSS:\s+(\d+)", Path("/proc/self/status").read_text())
    return int(found[1]) / 1000 if found else float("nan")


def started() -> tuple[Shown, list[Device]]:
    """What the virtual devices see, and the devices, started."""
    shown = Shown()
    devices = [open_device(address, shown) for address in DEVICES]
    for device in devices:
        device.start()
    return shown, devices


def rig_of(shown: Shown, devices: list[Device]) -> LiveRig:
    return LiveRig("x", devices, shown.calibration, {}, lambda address: open_device(address, shown))


def measure(path: Path, seconds: float) -> None:
    memory: list[float] = []
    with closing(rig_of(*started())) as rig:
        rig.record(path)
        before, end = time.process_time(), time.monotonic() + seconds
        rig.start()
        while time.monotonic() < end:
            time.sleep(1.0)
            memory.append(resident_mb())
    share = (time.process_time() - before) / seconds
    for name, stream in rig.health().streams.items():
        print(f"{name}: {stream.count} in {seconds:g} s, {stream.dropped} dropped")
    print(f"CPU, virtual devices included: {share:.0%} of a core; peak {peak_mb():.0f} MB")
    print(f"memory after 5 s {memory[min(5, len(memory) - 1)]:.0f} MB, at the end {memory[-1]:.0f} MB")
    frames = list(Session(path))
    print(f"with colour {np.mean([f.color_encoded is not None for f in frames]):.4f},", end=" ")
    print(
        f"with temperature {np.mean([f.thermal_c is not None for f in frames]):.4f} of {len(frames)} frames"
    )


def peak_mb() -> float:
    """The most memory that this process has held, in megabytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000


def kill(path: Path, seed: int) -> float:
    """Start a recording, kill it at a random moment; seconds from its last depth image to its death."""
    process = subprocess.Popen([sys.executable, "-m", "tools.measure.recording", "record", str(path)])
    partial = path.with_name(path.name + ".partial")
    while not partial.exists() or partial.stat().st_size < 100_000:
        time.sleep(0.01)
    time.sleep(np.random.default_rng(seed).uniform(0, 2))
    killed_ns = time.time_ns()
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    session = Session(partial)
    assert any("truncated" in note for note in session.notes)
    last_ns = int(session._places["/depth/image"]["arrival_ns"][-1])
    partial.unlink()
    return (killed_ns - last_ns) * 1e-9


def record_test_picture(path: Path) -> None:
    """Record for a minute: what ``kill`` starts."""
    with closing(rig_of(*started())) as rig:
        rig.record(path)
        rig.start()
        time.sleep(60)


def main(seconds: float, kills: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        measure(Path(folder) / "session.mcap", seconds)
        lost = [kill(Path(folder) / "killed.mcap", seed) for seed in range(kills)]
    if lost:
        print(
            f"{kills} kills: last depth image {np.median(lost):.3f} s before death, at most {max(lost):.3f} s"
        )


if __name__ == "__main__":
    if sys.argv[1:2] == ["record"]:
        sys.exit(record_test_picture(Path(sys.argv[2])))
    given = [float(argument) for argument in sys.argv[1:]]
    measured_s, kills = given + [60.0, 50.0][len(given) :]
    main(measured_s, int(kills))
