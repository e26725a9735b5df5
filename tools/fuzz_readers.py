"""Fuzzes the readers of bytes from outside: only the project's errors, no crash, no hang, bounded memory.

    pip install -e '.[fuzz]'
    python tools/fuzz_readers.py --seconds 1800 --reader session --seed 1 --findings fuzz/findings

Without ``--reader`` every reader gets ``--seconds``. Atheris (libFuzzer) leads by what the readers' Python
reaches: inputs that reach something new are kept under ``--inputs`` and spoilt further, also by the next
run. A reader works in a process of its own, so that a crash of native code is a finding too; each finding is
the spoilt sample, kept under ``--findings`` as READER-SEED-N; of what a fresh process reads without fault the
last is kept, as unrepeated-READER. Files are flushed to the disk at every turn:
with TMPDIR in memory (/dev/shm) it goes many times faster. ``tests/corpus`` holds those that were mended;
``tests/test_fuzz.py`` reads them all.
"""

import argparse
import faulthandler
import hashlib
import multiprocessing
import os
import random
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path

import atheris

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
# An editable install's own finder hands out code that Atheris has no hold of: it comes last.
sys.meta_path.sort(key=lambda finder: "ScikitBuild" in type(finder).__name__)
LED_BY = [
    "sensors", "annotate", "synth", "eval",
    "mcap", "rosbags", "google", "ezc3d", "laspy", "tifffile", "safetensors", "json", "tarfile",
]  # fmt: skip
"""Packages whose branches lead the search: ours, and the pure Python that stands between the bytes and us."""

with atheris.instrument_imports(include=LED_BY):
    from tools.fuzz_samples import READERS
    from tools.fuzz_spoil import Fuzzer, mutate, seal

HANG_S, HANG_WALL_S = 30.0, 600.0
"""A sample of a few kB that takes longer, of the processor or by the clock of a busy machine, hangs."""
MEMORY_BYTES = 2 << 30
"""What a reader may take beyond what its process has when it starts."""
MOST_FINDINGS = 20
"""Of a reader in one run: what is so broken is mended first."""
_NO_SIGNALS = [f"-handle_{name}=0" for name in ("segv", "bus", "abrt", "ill", "fpe", "int", "term", "xfsz")]


def fuzz(name: str, seconds: float, seed: int, inputs: Path, findings: Path) -> list[Path]:
    """Fuzz one reader for so many seconds of the processor; returns the folders of its findings."""
    found: list[Path] = []
    inputs.mkdir(parents=True, exist_ok=True)
    fork = multiprocessing.get_context("fork")
    with tempfile.TemporaryDirectory() as folder:
        count = fork.Value("q", 0)
        before_s, runs, deaths = _workers_s(), 0, 0
        while (left_s := seconds - (_workers_s() - before_s)) > 0 and len(found) < MOST_FINDINGS:
            root = Path(folder) / str(runs)
            root.mkdir()
            runs += 1
            worker = fork.Process(target=_work, args=(name, root, f"{seed}-{runs}", inputs, count, left_s))
            worker.start()
            why = _watch(worker, count)
            if why:
                again = fork.Process(target=_again, args=(name, root))
                again.start()
                if _watch(again, count):
                    found.append(_keep(f"{name}-{seed}-{count.value}", root, why, findings))
                else:
                    deaths += 1
                    _keep(f"unrepeated-{name}", root, why, findings)
                count.value += 1
            shutil.rmtree(root)
        spent_s = _workers_s() - before_s
    kept = sum(1 for _ in inputs.iterdir())
    said = f"{spent_s:.0f} CPU s, {count.value} samples, {kept} inputs, {deaths} deaths not repeated"
    print(f"{name}: {said}, {len(found)} findings", flush=True)
    if count.value <= deaths:
        sys.exit(f"{name}: nothing was read, the fuzzer itself fails; see {findings}/unrepeated-{name}")
    return found


def _workers_s() -> float:
    """Seconds of the processor that workers have taken so far, those that ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _work(name: str, root: Path, seed: str, inputs: Path, count: "Synchronized[int]", seconds: float) -> None:
    """Spoil and read until the time is over (exit 0) or something is found (exit 1, or a signal's)."""
    trace, log = (root / "trace").open("w"), (root / "log").open("w")
    for stream in (1, 2):
        os.dup2(log.fileno(), stream)  # libFuzzer's progress, libraries' complaints
    faulthandler.enable(trace)
    with atheris.instrument_imports(include=LED_BY):  # what is imported only when it is needed
        fuzzer = Fuzzer(READERS[name], root)
    names = sorted(fuzzer.files)
    for i, data in enumerate(fuzzer.files[name] for name in names):
        (inputs / f"good-{i}").write_bytes(bytes([i]) + data)
    _limit()

    def read(data: bytes) -> None:
        """data: the number of a file, then what to put there."""
        fuzzer.put({names[data[0] % len(names)]: data[1:]} if data else {})
        why = fuzzer.finding()
        if why:
            (root / "trace").write_text(why)
        count.value += 1
        if why or time.process_time() > seconds:
            os._exit(bool(why))

    largest = 2 * max(map(len, fuzzer.files.values()))
    number = int.from_bytes(hashlib.sha256(seed.encode()).digest()[:4]) or 1
    options = [f"-seed={number}", f"-max_len={largest}", f"-artifact_prefix={root}/"]
    options += ["-timeout=0", "-rss_limit_mb=0", *_NO_SIGNALS]
    atheris.Setup(["fuzz", *options, str(inputs)], read, custom_mutator=_mutator(len(names)))
    atheris.Fuzz()


def _again(name: str, root: Path) -> None:
    """Read what was found once more, in a fresh process: under Atheris one grows, and dies of it."""
    (root / "again").mkdir()
    fuzzer = Fuzzer(READERS[name], root / "again")
    shutil.rmtree(fuzzer.spoilt)
    shutil.copytree(root / "spoilt", fuzzer.spoilt)
    _limit()
    os._exit(bool(fuzzer.finding()))


def _limit() -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES, used + MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _mutator(files: int) -> Callable[[bytes, int, int], bytes]:
    """libFuzzer's mutations and ours in turn, with right sums behind every other one."""

    def spoil(data: bytes, most: int, seed: int) -> bytes:
        rng = random.Random(seed)
        which, content = data[:1] or b"\0", data[1:]
        if files > 1 and rng.random() < 0.02:
            which = bytes([rng.randrange(files)])
        spoilt = atheris.Mutate(content, most - 1) if rng.random() < 0.6 else mutate(content, rng)
        return (which + (seal(spoilt) if rng.random() < 0.5 else spoilt))[:most]

    return spoil


def _watch(worker: "multiprocessing.context.ForkProcess", count: "Synchronized[int]") -> str:
    """Wait for the worker; why it ended before its time, or ""."""
    seen, since, since_s = -1, time.monotonic(), 0.0
    while worker.is_alive():
        worker.join(0.2)
        if count.value != seen:
            seen, since, since_s = count.value, time.monotonic(), _processor_s(worker.pid)
        elif _processor_s(worker.pid) - since_s > HANG_S or time.monotonic() - since > HANG_WALL_S:
            worker.kill()
            worker.join()
            return f"no answer for {HANG_S:.0f} s of the processor or {HANG_WALL_S:.0f} s"
    return "" if worker.exitcode == 0 else f"exit {worker.exitcode}"


def _processor_s(pid: int | None) -> float:
    """Seconds of the processor that a worker has taken; 0 once it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _keep(name: str, root: Path, why: str, findings: Path) -> Path:
    kept = findings / name
    shutil.rmtree(kept, ignore_errors=True)
    if (root / "spoilt").is_dir():
        shutil.copytree(root / "spoilt", kept / "sample")
    kept.mkdir(parents=True, exist_ok=True)
    said = [path.read_text(errors="replace") for path in (root / "log", root / "trace") if path.is_file()]
    trace = next((text for text in reversed(said) if text), "")[-10_000:]
    (kept / "why.txt").write_text(f"{why}\n{trace}")
    lines = trace.strip().splitlines() or [""]
    print(f"{name}: {kept}: {why}: {lines[-1][:200]}", flush=True)
    return kept


def main() -> None:
    """Fuzz as the arguments say; exit 1 where there are findings."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="of the processor, for each reader")
    parser.add_argument("--reader", choices=sorted(READERS), action="append", help="which; all without it")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--inputs", type=Path, default=Path("fuzz/inputs"), help="grown, a folder a reader")
    parser.add_argument("--findings", type=Path, default=Path("fuzz/findings"))
    given = parser.parse_args()
    found = [
        path
        for name in given.reader or READERS
        for path in fuzz(name, given.seconds, given.seed, given.inputs / name, given.findings)
    ]
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
