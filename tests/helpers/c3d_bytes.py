"""C3D files written byte by byte, so that tests can make every defect that laboratories' files have."""

import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

PROCESSORS = {"intel": 84, "dec": 85, "mips": 86}
Texts = list[str]
Value = float | int | Texts


@dataclass
class C3d:
    """A file to write. points: (F, M, 3) in its unit, NaN where not seen; analog: samples (F, A).

    header: fields that contradict the parameters. parameters: (group, name, value) instead of what follows
    from the points, in order; a name twice is written twice, None leaves it out. gap: bytes of rubbish before
    the parameters. lost_frames: stated, not there. padded: to whole blocks of 512 bytes.
    """

    points: np.ndarray
    labels: Texts
    scale: float = -1.0
    rate: float = 100.0
    unit: str = "mm"
    processor: str = "intel"
    analog: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    header: dict[str, float] = field(default_factory=dict)
    parameters: list[tuple[str, str, Value | None]] = field(default_factory=list)
    gap: int = 0
    lost_frames: int = 0
    padded: bool = True

    def write(self, path: Path) -> Path:
        order = ">" if self.processor == "mips" else "<"
        start = 2 + self.gap // 512
        blocks = -(-len(self._parameters(order, 0)) // 512)
        data_block = start + blocks
        head = {
            "points": self.points.shape[1],
            "analog": self.analog.shape[1] if len(self.analog) else 0,
            "first": 1,
            "last": len(self.points),
            "scale": self.scale,
            "data_block": data_block,
            "per_frame": 1 if len(self.analog) else 0,
            "rate": self.rate,
        } | self.header
        words = [int(head[name]) for name in ("points", "analog", "first", "last")]
        packed = struct.pack(f"{order}5H", *words, 0) + self._float(order, head["scale"])
        packed += struct.pack(f"{order}2H", int(head["data_block"]), int(head["per_frame"]))
        packed += self._float(order, head["rate"])
        first = (bytes([start, 0x50]) + packed).ljust(512, b"\0") + b"\xff" * self.gap
        section = self._parameters(order, data_block).ljust(512 * blocks, b"\0")
        data = self._data(order)
        path.write_bytes(first + section + (data + b"\0" * (-len(data) % 512) if self.padded else data))
        return path

    def _float(self, order: str, value: float) -> bytes:
        if self.processor != "dec":
            return struct.pack(f"{order}f", value)
        low, high = struct.unpack("<2H", struct.pack("<f", 4 * value))
        return struct.pack("<2H", high, low)

    def _value(self, order: str, value: Value) -> bytes:
        if isinstance(value, float):
            return struct.pack("bB", 4, 0) + self._float(order, value)
        if isinstance(value, int):
            return struct.pack("bB", 2, 0) + struct.pack(f"{order}H", value)
        width = max((len(text) for text in value), default=0)
        texts = "".join(text.ljust(width) for text in value).encode("latin-1")
        return struct.pack("bBBB", -1, 2, width, len(value)) + texts

    def _parameters(self, order: str, data_block: int) -> bytes:
        point = {"USED": self.points.shape[1], "SCALE": float(self.scale), "RATE": float(self.rate)}
        point |= {"DATA_START": data_block, "FRAMES": len(self.points), "LABELS": self.labels}
        analog = {"USED": self.analog.shape[1] if len(self.analog) else 0, "RATE": float(self.rate)}
        analog |= {"SCALE": 1.0, "GEN_SCALE": 1.0, "OFFSET": 0}
        own = [("POINT", name, value) for name, value in (point | {"UNITS": [self.unit]}).items()]
        own += [("ANALOG", name, value) for name, value in analog.items()]
        given = {(group, name) for group, name, _ in self.parameters}
        rows = [row for row in own if row[:2] not in given] + self.parameters
        groups = {group: number + 1 for number, group in enumerate(dict.fromkeys(r[0] for r in rows))}
        entries = [_entry(order, group, -number, b"\0") for group, number in groups.items()]
        for group, name, value in rows:
            if value is not None:
                body = self._value(order, value) + b"\0"
                entries.append(_entry(order, name, groups[group], body))
        text = b"".join(entries) + b"\0\0"
        return bytes([1, 0x50, -(-(len(text) + 4) // 512), PROCESSORS[self.processor]]) + text

    def _data(self, order: str) -> bytes:
        frames = bytearray()
        for f in range(len(self.points) - self.lost_frames):
            for point in self.points[f]:
                seen = bool(np.isfinite(point).all())
                numbers = [*(point if seen else (0, 0, 0)), 0 if seen else -1]
                if self.scale < 0:
                    frames += b"".join(self._float(order, float(v)) for v in numbers)
                else:
                    counts = [round(v / self.scale) for v in numbers[:3]]
                    frames += struct.pack(f"{order}4h", *counts, int(numbers[3]))
            for sample in self.analog[f] if len(self.analog) else ():
                word = struct.pack(f"{order}h", int(sample))
                frames += self._float(order, sample) if self.scale < 0 else word
        return bytes(frames)


def _entry(order: str, name: str, group: int, body: bytes) -> bytes:
    return (
        struct.pack("bb", len(name), group) + name.encode() + struct.pack(f"{order}h", len(body) + 2) + body
    )
