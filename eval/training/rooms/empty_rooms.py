"""Rooms without people, random or close, as each kind of sensor reads them."""

from collections.abc import Iterator
from itertools import count

from eval.training.rooms.close_rooms import close_room
from eval.training.rooms.scenes import ROOMS_OF_PEOPLE, Scene, room
from synth.cameras.random_sensor import KINDS, draw_sensor
from synth.data_files import TRAINING, Cast
from synth.random_stream import stream

ROOMS = ("random", "close")


def empty_rooms(kind: str, sensor: str, seed: int, cast: Cast) -> Iterator[Scene]:
    """Yield empty rooms of one of ``ROOMS`` as a kind of sensor reads them, without end."""
    for number in count():
        rng = stream(seed, f"{kind} {sensor}", number)
        drawn = draw_sensor(rng, sensor)
        yield close_room(rng, drawn, None, cast) if kind == "close" else room(rng, drawn, [], cast)


def empty_scenes(seed: int) -> Iterator[Scene]:
    """Yield ``ROOMS_OF_PEOPLE`` empty rooms with the training cast's furniture, kinds and sensors in turn."""
    pairs = [(kind, sensor) for kind in ROOMS for sensor in KINDS]
    for number in range(ROOMS_OF_PEOPLE):
        kind, sensor = pairs[(seed * ROOMS_OF_PEOPLE + number) % len(pairs)]
        yield next(empty_rooms(kind, sensor, seed, TRAINING))
