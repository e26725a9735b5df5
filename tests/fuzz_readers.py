"""Fuzzes the readers of bytes from outside: only the project's errors, no crash, no hang, bounded memory.

    python tests/fuzz_readers.py --seconds 1800 --reader session --seed 1 --corpus findings

Without ``--reader`` every reader gets ``--seconds``. A reader works in a process of its own, so that a crash
of native code is a finding too; each finding is the mutated sample, kept under ``--corpus`` as READER-SEED-N.
Files are flushed to the disk at every turn: with TMPDIR in memory (/dev/shm) it goes many times faster.
``tests/corpus`` holds those that were mended; ``tests/test_fuzz.py`` reads them all.
"""

import argparse
import faulthandler
import multiprocessing
import os
import random
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]

from fuzz_samples import READERS, Reader  # noqa: E402

from sensors.errors import CloudError  # noqa: E402

HANG_S, HANG_WALL_S = 30.0, 600.0
"""A sample of a few kB that takes longer, of the processor or by the clock of a busy machine, hangs."""
MEMORY_BYTES = 2 << 30
"""What a reader may take beyond what its process has when it starts."""
NUMBERS = (
    b"0",
    b"-1",
    b"1e309",
    b"nan",
    b"4294967296",
    b"99999999999999999999",
    b"null",
    b"[]",
    b'"../../x"',
)


def mutate(data: bytes, rng: random.Random) -> bytes:
    """A few random changes: bits, bytes, numbers in text, pieces cut out, doubled, moved; the end cut off."""
    content = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        at, length = rng.randrange(len(content) + 1), rng.choice((1, 2, 4, 8, rng.randrange(1, 200)))
        match rng.randrange(8):
            case 0 | 1 if content:
                content[at % len(content)] ^= 1 << rng.randrange(8)
            case 2 if content:
                content[at % len(content)] = rng.choice((0, 1, 0x7F, 0x80, 0xFF))
            case 3:
                content[at : at + length] = rng.choice((b"\xff", b"\0", b"\x7f")) * length
            case 4:
                del content[at:]
            case 5:
                del content[at : at + length]
            case 6:
                begin = rng.randrange(len(content) + 1)
                content[at:at] = content[begin : begin + length]
            case _:
                _renumber(content, rng)
    return bytes(content)


def _renumber(content: bytearray, rng: random.Random) -> None:
    """Replace a run of digits, from a random place on, by a number nobody expects."""
    begin = rng.randrange(len(content) + 1)
    digits = next((i for i in range(begin, min(len(content), begin + 2000)) if 48 <= content[i] <= 57), None)
    if digits is not None:
        end = digits
        while end < len(content) and 48 <= content[end] <= 57:
            end += 1
        content[digits:end] = rng.choice(NUMBERS)


class Fuzzer:
    """One reader's samples in a folder: the good one, and a copy of it that is spoilt anew every time."""

    def __init__(self, reader: Reader, root: Path) -> None:
        self._read = reader.read
        good, self.spoilt = root / "good", root / "spoilt"
        good.mkdir()
        made = reader.make(good)
        reader.read(made)
        self._target = self.spoilt / made.relative_to(good)
        files = (file for file in sorted(good.rglob("*")) if file.is_file())
        self._files = {file.relative_to(good): file.read_bytes() for file in files}
        shutil.copytree(good, self.spoilt)

    def spoil(self, seed: object) -> None:
        """Spoil one file, now and then two or none at all; the others are whole again."""
        rng = random.Random(str(seed))
        chosen = rng.sample(sorted(self._files), k=min(len(self._files), rng.choice((1, 1, 1, 2))))
        for name, data in self._files.items():
            (self.spoilt / name).write_bytes(mutate(data, rng) if name in chosen else data)

    def finding(self) -> str:
        """Read what is spoilt; "" when it goes well or is refused in one line, else what happened."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self._read(self._target)
        except CloudError as error:
            return f"message of several lines: {error}" if "\n" in str(error) else ""
        except BaseException:
            return traceback.format_exc()
        return ""


def fuzz(name: str, seconds: float, seed: int, corpus: Path) -> list[Path]:
    """Fuzz one reader for so many seconds of the processor; returns the folders of its findings."""
    findings: list[Path] = []
    with tempfile.TemporaryDirectory() as folder:
        count = multiprocessing.Value("q", 0)
        before_s, runs = _workers_s(), 0
        while (left_s := seconds - (_workers_s() - before_s)) > 0:
            root = Path(folder) / str(runs)
            root.mkdir()
            runs += 1
            worker = multiprocessing.Process(target=_work, args=(name, root, seed, count, left_s))
            worker.start()
            why = _watch(worker, count)
            if why:
                findings.append(_keep(name, seed, count.value, root, why, corpus))
                count.value += 1
            shutil.rmtree(root)
        spent_s = _workers_s() - before_s
        print(f"{name}: {spent_s:.0f} CPU s, {count.value} samples, {len(findings)} findings", flush=True)
    return findings


def _workers_s() -> float:
    """Seconds of the processor that workers have taken so far, those that ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _work(
    name: str, root: Path, seed: int, count: "multiprocessing.sharedctypes.Synchronized[int]", seconds: float
) -> None:
    faulthandler.enable((root / "trace").open("w"))
    fuzzer = Fuzzer(READERS[name], root)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES, used + MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    while time.process_time() < seconds:
        fuzzer.spoil((seed, count.value))
        why = fuzzer.finding()
        if why:
            (root / "trace").write_text(why)
            os._exit(1)
        count.value += 1
    os._exit(0)


def _watch(worker: multiprocessing.Process, count: "multiprocessing.sharedctypes.Synchronized[int]") -> str:
    """Wait for the worker; why it ended before its time, or ""."""
    seen, since, since_s = -1, time.monotonic(), 0.0
    while worker.is_alive():
        worker.join(0.2)
        if count.value != seen:
            seen, since, since_s = count.value, time.monotonic(), _processor_s(worker)
        elif _processor_s(worker) - since_s > HANG_S or time.monotonic() - since > HANG_WALL_S:
            worker.kill()
            worker.join()
            return f"no answer for {HANG_S:.0f} s of the processor or {HANG_WALL_S:.0f} s"
    return "" if worker.exitcode == 0 else f"exit {worker.exitcode}"


def _processor_s(worker: multiprocessing.Process) -> float:
    """Seconds of the processor that a worker has taken; 0 once it has ended."""
    try:
        fields = Path(f"/proc/{worker.pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _keep(name: str, seed: int, number: int, root: Path, why: str, corpus: Path) -> Path:
    kept = corpus / f"{name}-{seed}-{number}"
    shutil.rmtree(kept, ignore_errors=True)
    if (root / "spoilt").is_dir():
        shutil.copytree(root / "spoilt", kept / "sample")
    kept.mkdir(parents=True, exist_ok=True)
    trace = (root / "trace").read_text() if (root / "trace").is_file() else ""
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
    parser.add_argument("--corpus", type=Path, default=Path("fuzz-findings"))
    given = parser.parse_args()
    found = [
        path
        for name in given.reader or READERS
        for path in fuzz(name, given.seconds, given.seed, given.corpus)
    ]
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
