"""What many frames cost: ``python -m tests.measure_load FOLDER SESSION.mcap [--sizes N ...]``.

SESSION comes from ``simulate``, with its truth and suit beside it, and is lengthened by repeating it. Every
verb runs in a process of its own at every size. What it took goes to FOLDER/load.jsonl, so that a broken run
goes on; the table is of that file. A frame's cost is that of one frame more between a size and the next
smaller one: what starting costs is left out, or it would hide what grows.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from annotate.labelset.store import FRAMES, MANIFEST, LabelSet
from sensors.frame import FRAME_PERIOD_NS
from sensors.replay import Session
from sensors.session import SessionWriter
from synth.simulate import suit_path, truth_path

MAIN = [sys.executable, "-c", "from cli.main import main; main()"]
READ = [sys.executable, "-c", "import sys; from tests.measure_load import data_path; data_path(sys.argv[1])"]
DATA = "training's data"
SAMPLE_S = 0.5
TICKS = os.sysconf("SC_CLK_TCK")
AUGMENTED = 100
"""Images that training's data path is asked for once all are read."""


@dataclass(frozen=True)
class Sample:
    """A moment of a run: frames done, processor seconds and megabytes of all its processes."""

    done: int
    cpu_s: float
    resident_mb: float


@dataclass(frozen=True)
class Cost:
    """What a verb took. peak_mb: of its largest process."""

    verb: str
    size: int
    cpu_s: float
    peak_mb: float
    samples: tuple[Sample, ...]


def processes(pid: int) -> Iterator[int]:
    """A process and all below it."""
    yield pid
    for children in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in children.read_text().split():
            yield from processes(int(child))


def sampled(pid: int, log: Path) -> Sample:
    """Where a run is. Raises OSError where one of its processes ended just now."""
    cpu = resident = 0.0
    for each in processes(pid):
        fields = Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split()
        # User and system time, own and of children that have ended (proc(5), fields 14 to 17).
        cpu += sum(map(int, fields[11:15])) / TICKS
        resident += int(fields[21]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    told = re.findall(r": (\d+)/\d+,", log.read_text(errors="replace"))
    return Sample(int(told[-1]) if told else 0, round(cpu, 2), round(resident, 1))


def run(verb: str, size: int, command: list[str], log: Path) -> Cost:
    """Run a command to its end and measure it. Raises RuntimeError where it fails."""
    samples = []
    with log.open("w") as file:
        pid = subprocess.Popen(command, stdout=file, stderr=file).pid
        while not (ended := os.wait4(pid, os.WNOHANG))[0]:
            with suppress(OSError):
                samples.append(sampled(pid, log))
            time.sleep(SAMPLE_S)
    if ended[1]:
        raise RuntimeError(f"{verb} of {size}: {log.read_text()[-500:]}")
    used = ended[2]
    step = max(1, len(samples) // 200)
    return Cost(verb, size, used.ru_utime + used.ru_stime, used.ru_maxrss / 1000, tuple(samples[::step]))


def long_session(short: Path, out: Path, frames: int) -> None:
    """A session that shows the frames of another again and again, with time going on."""
    source = Session(short)
    shown = list(source)
    with SessionWriter(out, source.calibration, source.name) as writer:
        for index in range(frames):
            frame = shown[index % len(shown)]
            writer.write(replace(frame, index=index, stamp_ns=index * 15 * FRAME_PERIOD_NS))


def long_labels(short: Path, out: Path, frames: int) -> None:
    """A label set that holds the frames of another again and again, as links to its files."""
    ids = LabelSet.open(short).frame_ids
    files = {i: sorted((short / FRAMES).glob(f"{i}.*")) for i in ids}
    (out / FRAMES).mkdir(parents=True)
    shutil.copy(short / MANIFEST, out / MANIFEST)
    for index in range(frames):
        for file in files[ids[index % len(ids)]]:
            (out / FRAMES / f"{index:06d}{file.name[file.name.index('.') :]}").hardlink_to(file)


def data_path(dataset: str) -> None:
    """What a training reads before and while it computes."""
    from eval.augment import Augmentation
    from eval.data import load_crops
    from eval.loader import Images, Order, batches

    crops = load_crops([Path(dataset)])
    order = Order(len(crops), 20, 12, 0)
    for number, _ in enumerate(batches(Images(crops, Augmentation(), 0), order, 0), 1):
        if number * 20 >= min(AUGMENTED, len(crops)):
            break


def session_commands(folder: Path, short: Path, size: int) -> dict[str, list[object]]:
    """Every verb on a session and its labels, in an order in which they can run."""
    session, labels, truth = (folder / f"{size}{kind}" for kind in (".mcap", "-labels", "-truth"))
    made = {name: folder / f"{size}-{name}" for name in ("labelled", "predicted", "mmseg", "parquet", "back")}
    result = folder / f"{size}-result.json"
    page = folder / f"{size}-report.html"
    return {
        "info of a session": ["info", session],
        "validate a session": ["validate", session],
        "label": ["label", session, "--suit", suit_path(short), "--out", made["labelled"]],
        "info of labels": ["info", labels],
        "validate labels": ["validate", labels],
        "predict within labels": ["predict", labels, "--out", made["predicted"]],
        "diff": ["diff", labels, truth],
        "evaluate": ["evaluate", labels, truth, "--out", result],
        "report": ["report", result, "--session", session, "--out", page],
        "export to mmseg": ["export", labels, made["mmseg"], "--format", "mmseg"],
        "export to Parquet": ["export", labels, made["parquet"], "--format", "parquet"],
        "import of Parquet": ["import", made["parquet"], made["back"]],
    }


def dataset_commands(folder: Path, size: int) -> dict[str, list[object]]:
    """Every verb on a dataset; its own labels stand in for predicted ones where measuring is the question."""
    images, result = folder / f"{size}-images", folder / f"{size}-images.json"
    generate = ["--preset", "sitting-train", "--count", size, "--workers", 1]
    return {
        "synth generate": ["synth", "generate", *generate, "--out", images],
        "info of a dataset": ["info", images],
        "validate a dataset": ["validate", images],
        "evaluate a dataset": ["evaluate", images, images, "--out", result],
        "report of a dataset": ["report", result, "--out", folder / f"{size}-images-report.html"],
        DATA: [images],
        "predict a dataset": ["predict", images, "--out", folder / f"{size}-images-predicted"],
    }


def prepare(arguments: list[object], folder: Path, short: Path, labels: Path, size: int) -> None:
    """What a command reads: the long session, its labels, its truth."""
    session = folder / f"{size}.mcap"
    if session in arguments and not session.exists():
        long_session(short, session, size)
    for kind, source in (("labels", labels), ("truth", truth_path(short))):
        if (out := folder / f"{size}-{kind}") in arguments and not out.exists():
            long_labels(source, out, size)


def table(costs: list[Cost]) -> str:
    """Markdown: by verb and size the processor time of one frame more, its ratio, and the memory."""
    lines = [
        "| verb | frames | processor time | of one more | ratio | peak | held after a tenth, at the end |",
        "|---|---|---|---|---|---|---|",
    ]
    for verb in dict.fromkeys(cost.verb for cost in costs):
        own = sorted((cost for cost in costs if cost.verb == verb), key=lambda cost: cost.size)
        first = 0.0
        for before, cost in zip([None, *own], own, strict=False):
            more = ratio = ""
            if before:
                each = 1000 * (cost.cpu_s - before.cpu_s) / (cost.size - before.size)
                more, ratio = f"{each:.2f} ms", f"{each / first:.2f}" if first else ""
                first = first or each
            # The last sample may be of a process that has just ended and holds nothing.
            held = [sample.resident_mb for sample in cost.samples if sample.resident_mb] or [0.0]
            lines.append(
                f"| {verb} | {cost.size:,} | {cost.cpu_s:.1f} s | {more} | {ratio} | {cost.peak_mb:.0f} MB "
                f"| {held[len(held) // 10]:.0f}, {held[-1]:.0f} MB |"
            )
    return "\n".join(lines)


def read_costs(path: Path) -> list[Cost]:
    """What was measured so far."""
    lines = path.read_text().splitlines() if path.exists() else []
    fields = [json.loads(line) for line in lines]
    return [Cost(**{**f, "samples": tuple(Sample(**s) for s in f["samples"])}) for f in fields]


def main() -> None:
    """Measure what is not measured yet, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("session", type=Path)
    parser.add_argument("--labels", type=Path, help="label set of SESSION; else its truth")
    parser.add_argument("--sizes", type=int, nargs="+", default=[100, 1000, 10_000])
    parser.add_argument("--verbs", nargs="*", help="else all")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    kept = asked.folder / "load.jsonl"
    known = {(cost.verb, cost.size) for cost in read_costs(kept)}
    for size in asked.sizes:
        commands = session_commands(asked.folder, asked.session, size) | dataset_commands(asked.folder, size)
        for verb, arguments in commands.items():
            if (verb, size) in known or (asked.verbs is not None and verb not in asked.verbs):
                continue
            prepare(arguments, asked.folder, asked.session, asked.labels or truth_path(asked.session), size)
            command = [*(READ if verb == DATA else MAIN), *map(str, arguments)]
            cost = run(verb, size, command, asked.folder / "log")
            with kept.open("a") as file:
                file.write(json.dumps(asdict(cost)) + "\n")
            print(f"{verb} {size}: {cost.cpu_s:.1f} s, {cost.peak_mb:.0f} MB", file=sys.stderr, flush=True)
    print(table(read_costs(kept)))


if __name__ == "__main__":
    main()
