"""Fuzz a reader of files from outside, guided by coverage.

python -m tools.fuzz.run READER [SECONDS] [FOLDER]

Needs the extra `fuzz` (Atheris: libFuzzer for Python). READER is a name in `tools.fuzz.samples`; without one,
every reader gets 60 seconds. FOLDER/READER (fuzz/READER) keeps inputs that reach new branches. A fault is an
end other than a good one or one printable line of error, over 2 GB of memory, or over 30 seconds. A fault
ends the run; libFuzzer writes its input to crash-*, oom-* or timeout-*: one byte, the number of the file,
then the content of the file. `tests/corpus` holds earlier faults.
"""

import random
import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from zlib import crc32

import atheris

with atheris.instrument_imports(
    include=["sensors", "annotate", "synth", "eval", "mcap", "rosbags", "tarfile"]
):
    from tools.fuzz.reader import Sample
    from tools.fuzz.samples import READERS

PNG = b"\x89PNG\r\n\x1a\n"


def sealed(data: bytes) -> bytes:
    """Return the data with correct checksums in the headers of a tar and the chunks of PNGs."""
    content = bytearray(data)
    if content[257:262] == b"ustar":
        at = 0
        while at + 512 <= len(content) and content[at]:
            content[at + 148 : at + 156] = b" " * 8
            content[at + 148 : at + 156] = b"%06o\0 " % sum(content[at : at + 512])
            digits = bytes(content[at + 124 : at + 136]).strip(b" \0")
            size = int(digits, 8) if digits and all(48 <= digit < 56 for digit in digits) else 0
            at += 512 * (1 + -(-size // 512))
    at = content.find(PNG)
    while at >= 0:
        at += len(PNG)
        while at + 12 <= len(content):
            end = at + 8 + int.from_bytes(content[at : at + 4])
            if end + 4 > len(content):
                break
            struct.pack_into(">I", content, end, crc32(content[at + 4 : end]))
            at = end + 4
        at = content.find(PNG, at)
    return bytes(content)


def fuzz(name: str, seconds: int, inputs: Path) -> None:
    """Fuzz one reader in this process, which ends with it."""
    sample = Sample(READERS[name], Path(tempfile.mkdtemp()))
    paths = sorted(sample.files)
    inputs.mkdir(parents=True, exist_ok=True)
    for i, path in enumerate(paths):
        (inputs / f"good-{i}").write_bytes(bytes([i]) + sample.files[path])

    def read(data: bytes) -> None:
        fault = sample.fault({paths[data[0] % len(paths)]: data[1:]}) if data else ""
        if fault:
            raise RuntimeError(fault)

    def change(data: bytes, most: int, seed: int) -> bytes:
        changed = atheris.Mutate(data, most)
        return (changed[:1] + sealed(changed[1:]) if random.Random(seed).random() < 0.5 else changed)[:most]

    longest = 2 * max(map(len, sample.files.values()))
    options = [f"-max_total_time={seconds}", f"-max_len={longest}", f"-artifact_prefix={inputs}/"]
    options += ["-timeout=30", "-rss_limit_mb=2048"]
    atheris.Setup(["fuzz", *options, str(inputs)], read, custom_mutator=change)
    atheris.Fuzz()


def main(name: str = "", seconds: str = "60", folder: str = "fuzz") -> None:
    """Fuzz one reader here, or every reader in its own process; exit with 1 for a fault."""
    if name:
        fuzz(name, int(seconds), Path(folder) / name)
    commands = [[sys.executable, "-m", "tools.fuzz.run", each, seconds, folder] for each in READERS]
    failed = [command[3] for command in commands if subprocess.run(command, check=False).returncode]
    sys.exit(f"faults in: {', '.join(failed)}" if failed else 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
