"""Device addresses: ``[virtual:]KIND[:TARGET][?KEY=VALUE&...]``."""

from collections.abc import Mapping
from typing import TypeVar
from urllib.parse import parse_qsl

from sensors.errors import DeviceError

T = TypeVar("T")


class Address:
    """A parsed address, whose options are taken one by one; ``finish`` refuses those that were not.

    Raises DeviceError for a malformed address.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        path, _, query = text.partition("?")
        self.virtual = path.startswith("virtual:")
        self.kind, _, self.target = path.removeprefix("virtual:").partition(":")
        try:
            pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query), max_num_fields=20)
        except ValueError as error:
            raise DeviceError(f"device {text!r} has malformed options; give KIND:TARGET?KEY=VALUE") from error
        self._options, self._known = dict(pairs), set[str]()
        if len(self._options) < len(pairs):
            raise DeviceError(f"device {text!r} gives an option twice; give each once")

    def choice(self, key: str, table: Mapping[str, T], default: str) -> T:
        """The entry of ``table`` that option ``key`` names. Raises DeviceError."""
        name = self._take(key, default)
        if name not in table:
            raise DeviceError(f"{key} {name!r} of device {self.text!r} is unknown; use {', '.join(table)}")
        return table[name]

    def number(self, key: str, default: float, low: float, high: float) -> float:
        """Option ``key`` as a number from ``low`` to ``high``. Raises DeviceError."""
        value = self.given_number(key, low, high)
        return default if value is None else value

    def given_number(self, key: str, low: float, high: float) -> float | None:
        """As ``number``, None where the option is not given."""
        text = self._take(key, "")
        if not text:
            return None
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            raise DeviceError(f"{key} {text!r} of {self.text!r} is not a number from {low:g} to {high:g}")
        return value

    def given_integer(self, key: str, low: int, high: int) -> int | None:
        """As ``given_number``, for whole numbers."""
        value = self.given_number(key, low, high)
        if value is not None and value != int(value):
            raise DeviceError(f"{key} {value:g} of {self.text!r} is not an integer; give {low} to {high}")
        return None if value is None else int(value)

    def finish(self) -> None:
        """Raise DeviceError for an option that was not taken."""
        if unknown := sorted(set(self._options) - self._known):
            known = ", ".join(sorted(self._known)) or "none"
            raise DeviceError(f"device {self.text!r} has unknown option {unknown[0]!r}; its options: {known}")

    def _take(self, key: str, default: str) -> str:
        self._known.add(key)
        return self._options.get(key, default)
