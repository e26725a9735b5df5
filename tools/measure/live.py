"""The live pipeline on virtual devices: ``python -m tools.measure.live SESSION [SECONDS]``; see ``--help``.

The devices show the frames of the session, whose suit lies beside it. Everything is recorded meanwhile.
Prints the labelled frames a second, their age, drops, the share of a core and the memory. On a busy machine
the CPU time of a labelled frame is the most reliable of these.
"""

import argparse
import re
import tempfile
import time
from pathlib import Path

from annotate.gui.app import run_live
from annotate.suit.palette import load_suit
from cli.live_view import labelling_by, run_pipeline
from sensors.recording.live_rig import LiveRig
from sensors.recording.open_device import open_device
from sensors.session.reader import Session
from synth.rig.simulate import suit_path

DEVICES = ("virtual:kinect2", "virtual:optris-direct", "virtual:pyrometer?family=ct")


def resident_mb() -> float:
    """Return the memory that this process holds now, in megabytes."""
    found = re.search(r"VmRSS:\s+(\d+)", Path("/proc/self/status").read_text())
    return int(found[1]) / 1000 if found else float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("session", type=Path)
    parser.add_argument("seconds", type=float, nargs="?", default=30.0)
    parser.add_argument("--network", action="store_true")
    parser.add_argument("--window", action="store_true")
    options = parser.parse_args()
    source = Session(options.session)
    scene, suit = list(source), None if options.network else load_suit(suit_path(options.session))
    labelling = labelling_by(suit)
    devices = [open_device(address, scene) for address in DEVICES]
    for device in devices:
        device.start()
    rig = LiveRig("virtual", devices, source.calibration, {}, lambda address: open_device(address, scene))
    with tempfile.TemporaryDirectory() as folder:
        take = Path(folder) / "take.mcap"
        with run_pipeline(rig, labelling) as pipeline:
            pipeline.frames.after(0, 60.0)  # kernels and networks are loaded
            rig.record(take)
            begun, memory = pipeline.frames.count, resident_mb()
            cpu_s, began_s = time.process_time(), time.monotonic()
            pipeline.latencies_ms.clear()
            if options.window:
                run_live(pipeline, iter(()), "", options.seconds, lambda: False)
            else:
                time.sleep(options.seconds)
            wall_s, cpu_s = time.monotonic() - began_s, time.process_time() - cpu_s
            labelled, health = pipeline.frames.count - begun, rig.health()
            rig.end_recording()
            median_ms, p95_ms = (pipeline.latency_ms(share) for share in (0.5, 0.95))
            rate_hz, each_ms = labelled / wall_s, 1000 * cpu_s / max(labelled, 1)
            print(f"labelled {rate_hz:.1f} a second, {each_ms:.0f} ms CPU each")
            print(f"old: {median_ms:.0f} ms (median), {p95_ms:.0f} ms (95th percentile)")
            print(f"CPU {cpu_s / wall_s:.0%} of a core; memory {memory:.0f} to {resident_mb():.0f} MB")
            print(f"warnings: {pipeline.warned}")
        for name, stream in health.streams.items():
            print(f"{name}: {stream.count} came, {stream.dropped} dropped")
        print(f"recorded {len(Session(take)) / wall_s:.1f} frames a second")


if __name__ == "__main__":
    main()
