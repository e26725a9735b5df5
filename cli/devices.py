"""The verb ``devices``: what can be recorded from."""

from dataclasses import asdict

from cli.console import Json, finish


def devices(json: Json = False) -> None:
    """List the devices that are plugged in, and the virtual ones."""
    from sensors.recording.open_device import find_devices

    found = find_devices()
    lines = [
        "  ".join(part for part in (f"{one.address:<32}", one.serial, one.note) if part) for one in found
    ]
    if all(one.virtual for one in found):
        lines.insert(0, "no device is plugged in; virtual devices:")
    finish({"devices": [asdict(one) for one in found]}, json, "\n".join(line.rstrip() for line in lines))
