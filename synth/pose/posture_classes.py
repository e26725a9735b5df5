"""Postures of activities: the one of ``annotate.posture.POSTURES`` in which each is done."""

from functools import lru_cache

from synth.data_files import table

_ON_THE_FLOOR = {
    "standing": "standing",
    "stooping": "standing",
    "crouching": "crouching",
    "cowering": "crouching",
    "squatting": "crouching",
    "kneeling": "kneeling",
    "kneeling_on_heels": "kneeling",
    "half_kneeling_left": "kneeling",
    "half_kneeling_right": "kneeling",
    "all_fours": "on all fours",
}
"""Upright and standing people; somebody who gets up is between two postures and has none."""


def posture_of(*activities: str) -> str | None:
    """Posture that activities of ``synth/data/poses`` share; None between two, or of one not known."""
    postures = {_postures().get(activity) for activity in activities}
    return postures.pop() if len(postures) == 1 else None


@lru_cache(maxsize=1)
def _postures() -> dict[str, str]:
    recumbent = table("poses/recumbent")
    return {
        **dict.fromkeys(table("poses/sitting")["sitting"], "sitting"),
        **dict.fromkeys([*recumbent["in_bed"], *recumbent["fallen"]], "lying"),
        **dict.fromkeys(table("poses/standing")["stances"], "standing"),
        **_ON_THE_FLOOR,
    }
