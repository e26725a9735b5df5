"""What many frames and images cost: ``python -m tools.load.measure FOLDER SESSION.mcap [--sizes N ...]``.

SESSION comes from ``simulate``, with its truth and suit beside it, and is lengthened by repeating it; so is a
dataset of 1,024 images by their shards under new ids. Every verb runs in a process of its own at every size.

A long run (STREAMS) is really done at its ends only, and its cost is that of an item at either end. ``label``
takes over what lies between, as from a run that broke off. ``synth generate`` makes the last two shards of a
dataset that has all others; ``predict`` labels these into a set that has all others; ``evaluate`` gives the
images between the first and the last thousand the counts of those; ``train`` does the first and the last
steps of an epoch. Of every other verb the cost is that of one item more between a size and the next smaller
one: what starting costs is left out, or it would hide what grows.

What it took goes to FOLDER/load.jsonl, so that a broken run goes on; the tables are of that file.
"""

import argparse
import json
import math
import os
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from synth.rig.simulate import suit_path, truth_path
from tools.load.material import LAST, SHARD, broken_off, last_shards, long_dataset, long_labels, long_session
from tools.load.probes import EVERY_S, Sample, sampled

IMAGES = 1024
"""Images of the dataset that is really made: four shards."""
READ = 10_240
"""Images that a long training really reads; of more it is given the crops of these again and again."""
ENDS = 100
"""Frames that a long label really does at either end."""
STREAMS = {"label": ENDS, "predict": SHARD, "synth generate": SHARD, "evaluate": 3 * SHARD}
"""Long runs, and over how many items at either end their cost is taken."""


@dataclass(frozen=True)
class Cost:
    """What a verb took. own_mb, resident_mb: the most that its largest process held, see ``Sample``."""

    verb: str
    size: int
    cpu_s: float
    own_mb: float
    resident_mb: float
    samples: tuple[Sample, ...]

    def each_ms(self, first: int, last: int) -> float:
        """Processor time of an item between these two; NaN where none was seen."""
        seen = [s for s in self.samples[:-1] if first <= s.done <= last]
        if len(seen) < 2 or seen[-1].done == seen[0].done:
            return math.nan
        return 1000 * (seen[-1].cpu_s - seen[0].cpu_s) / (seen[-1].done - seen[0].done)


def run(verb: str, size: int, command: list[str], log: Path) -> Cost:
    """Run a command to its end and measure it. Raises RuntimeError where it fails."""
    told, own, resident = log.with_suffix(".samples"), 0.0, 0.0
    what = verb if verb in ("evaluate", "train") else "command"
    probe = [sys.executable, "-m", "tools.load.probes", what, str(told), *command]
    with log.open("w") as file:
        pid = subprocess.Popen(probe, stdout=file, stderr=file).pid
        while not (ended := os.wait4(pid, os.WNOHANG))[0]:
            with suppress(OSError):
                now = sampled(pid)
                own, resident = max(own, now.own_mb), max(resident, now.resident_mb)
            time.sleep(EVERY_S)
    if ended[1]:
        raise RuntimeError(f"{verb} of {size}: {log.read_text()[-500:]}")
    used = ended[2]
    samples = tuple(Sample(**fields) for fields in json.loads(told.read_text()))
    return Cost(verb, size, used.ru_utime + used.ru_stime, own, resident, samples)


def session_commands(folder: Path, short: Path, size: int) -> dict[str, list[object]]:
    """Every verb on a session and its labels, in an order in which they can run."""
    session, labels, truth = (folder / f"{size}{kind}" for kind in (".mcap", "-labels", "-truth"))
    made = {name: folder / f"{size}-{name}" for name in ("labelled", "predicted", "mmseg", "parquet", "back")}
    result = folder / f"{size}-result.npz"
    page = folder / f"{size}-report.html"
    return {
        "info of a session": ["info", session],
        "validate a session": ["validate", session],
        "label": ["label", session, "--suit", suit_path(short), "--out", made["labelled"]],
        "info of labels": ["info", labels],
        "validate labels": ["validate", labels],
        "predict within labels": ["predict", labels, "--out", made["predicted"]],
        "diff": ["diff", labels, truth],
        "evaluate labels": ["evaluate", labels, truth, "--out", result],
        "report": ["report", result, "--session", session, "--out", page],
        "export to mmseg": ["export", labels, made["mmseg"], "--format", "mmseg"],
        "export to Parquet": ["export", labels, made["parquet"], "--format", "parquet"],
        "import of Parquet": ["import", made["parquet"], made["back"]],
    }


def dataset_commands(folder: Path, size: int) -> dict[str, list[object]]:
    """Every verb on a dataset."""
    images, result = folder / f"{size}-images", folder / f"{size}-images.npz"
    labelled = images if size <= IMAGES else folder / f"{size}-last"
    predicted = folder / f"{size}-predicted"
    generate = ["--preset", "sitting-train", "--count", size, "--workers", 1]
    return {
        "synth generate": ["synth", "generate", *generate, "--out", images],
        "info of a dataset": ["info", images],
        "validate a dataset": ["validate", images],
        "predict": ["predict", labelled, "--out", predicted],
        "evaluate": [predicted, images, "--out", result],
        "report of a dataset": ["report", result, "--out", folder / f"{size}-images-report.html"],
        "train": [folder / f"{min(size, READ)}-images", size],
    }


def prepare(verb: str, arguments: list[object], folder: Path, short: Path, labels: Path, size: int) -> None:
    """What a command reads, and what it goes on with: long sessions, labels and datasets."""
    session, images = folder / f"{size}.mcap", folder / f"{size}-images"
    if session in arguments and not session.exists():
        long_session(short, session, size)
    for kind, source in (("labels", labels), ("truth", truth_path(short))):
        if (out := folder / f"{size}-{kind}") in arguments and not out.exists():
            long_labels(source, out, range(size), "{:06d}".format)
    out = Path(str(arguments[-1]))
    if out.exists():
        return
    if verb == "label" and size > 3 * ENDS:
        few = folder / "few"
        if not few.exists():
            call = ["label", str(short), "--suit", str(suit_path(short)), "--out", str(few)]
            run("label", 0, call, folder / "log")
        broken_off(few, out, range(ENDS, size - ENDS), session, "{:06d}".format)
    if verb == "synth generate" and size > IMAGES:
        long_dataset(folder / f"{IMAGES}-images", images, size)
    if verb == "predict" and size > IMAGES:
        last = folder / f"{size}-last"
        last_shards(images, last)
        broken_off(folder / f"{IMAGES}-predicted", out, range(size - LAST * SHARD), last, "{:08d}".format)


def streams(costs: list[Cost]) -> str:
    """Markdown: what an item costs at either end of long runs, its ratio to the first size, and memory."""
    lines = [
        "| verb | items | one at the start | taken over | one at the end | ratio | own memory | with files |",
        "|---|---|---|---|---|---|---|---|",
    ]
    costs = sorted(costs, key=lambda cost: cost.size)
    for verb, ends in STREAMS.items():
        least = 0.0
        for cost in (cost for cost in costs if cost.verb == verb):
            # A long predict sees the last shards only, beside all others.
            n = cost.samples[-1].done if verb == "predict" else cost.size
            start, end = cost.each_ms(ends // 10, ends), cost.each_ms(n - ends, n)
            least = least or (start if verb == "label" else cost.each_ms(ends // 10, n))
            over = cost.each_ms(2 * ends, n - 2 * ends) if verb == "label" else math.nan
            lines.append(_row(cost, start, _ms(over), end, end / least))
    least = 0.0
    for cost in (cost for cost in costs if cost.verb == "train"):
        read, *steps = cost.samples[:-1]
        pairs = zip(steps[::2], steps[1::2], strict=True)
        start, end = (1000 * (b.cpu_s - a.cpu_s) / (b.done - a.done) for a, b in pairs)
        least = least or start
        lines.append(_row(cost, start, f"{read.done:,} read in {read.cpu_s:.1f} s", end, end / least))
    return "\n".join(lines)


def _row(cost: Cost, start: float, over: str, end: float, ratio: float) -> str:
    return (
        f"| {cost.verb} | {cost.size:,} | {_ms(start)} | {over} | {_ms(end)} | {ratio:.2f} "
        f"| {cost.own_mb:.0f} MB | {cost.resident_mb:.0f} MB |"
    )


def _ms(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.1f} ms"


def table(costs: list[Cost]) -> str:
    """Markdown: by verb and size the processor time of one frame more, its ratio, and the memory."""
    lines = [
        "| verb | items | processor time | of one more | ratio | own memory | with files |",
        "|---|---|---|---|---|---|---|",
    ]
    for verb in dict.fromkeys(cost.verb for cost in costs if cost.verb not in (*STREAMS, "train")):
        own = sorted((cost for cost in costs if cost.verb == verb), key=lambda cost: cost.size)
        first = 0.0
        for before, cost in zip([None, *own], own, strict=False):
            more = ratio = ""
            if before:
                each = 1000 * (cost.cpu_s - before.cpu_s) / (cost.size - before.size)
                more, ratio = f"{each:.2f} ms", f"{each / first:.2f}" if first else ""
                first = first or each
            lines.append(
                f"| {verb} | {cost.size:,} | {cost.cpu_s:.1f} s | {more} | {ratio} | {cost.own_mb:.0f} MB "
                f"| {cost.resident_mb:.0f} MB |"
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
    parser.add_argument("--sizes", type=int, nargs="*", default=[100, 1000, 10_000], help="of sessions")
    parser.add_argument("--images", type=int, nargs="*", default=[IMAGES, 10_240, 102_400])
    parser.add_argument("--verbs", nargs="*", help="else all")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    kept = asked.folder / "load.jsonl"
    known = {(cost.verb, cost.size) for cost in read_costs(kept)}
    every = [(size, session_commands(asked.folder, asked.session, size)) for size in asked.sizes]
    every += [(size, dataset_commands(asked.folder, size)) for size in asked.images]
    for size, commands in every:
        for verb, arguments in commands.items():
            if (verb, size) in known or (asked.verbs is not None and verb not in asked.verbs):
                continue
            labels = asked.labels or truth_path(asked.session)
            prepare(verb, arguments, asked.folder, asked.session, labels, size)
            cost = run(verb, size, list(map(str, arguments)), asked.folder / "log")
            with kept.open("a") as file:
                file.write(json.dumps(asdict(cost)) + "\n")
            print(f"{verb} {size}: {cost.cpu_s:.1f} s, {cost.own_mb:.0f} MB", file=sys.stderr, flush=True)
    print(streams(read_costs(kept)), table(read_costs(kept)), sep="\n\n")


if __name__ == "__main__":
    main()
