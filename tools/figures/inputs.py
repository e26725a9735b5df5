"""Suit network without each input: table of changes, and their conclusion in words."""

from collections.abc import Mapping

from synth.data_files import JUDGE
from synth.rig.virtual_rig import RigOptions, VirtualRig
from tools.figures.figure import Figure, Rows
from tools.figures.parallel import each
from tools.figures.rig import DIFFICULTIES, PEOPLE, simulated
from tools.measure import ablation
from tools.measure.ablation import SECONDS, SHOWN, Found, changes

FRAMES = 24  # of a recording
SPECS = {SHOWN["mean_recall"][0]: ".3f", SECONDS: ".1f"}
"""Formats of the measures, by heading."""
COLUMNS = {f"{heading}, `{of}`": spec for heading, spec in SPECS.items() for of in DIFFICULTIES}
NETWORKS = {name: f"{name}: change from `predict`" for name in (ablation.SUIT, ablation.DEPTH_ALONE)}
"""Rows of the suit network without an input, compared with the depth network on the same frames."""
SUBJECTS = {
    ablation.SUIT: "The suit's colours are worth",
    ablation.TEMPERATURE: "Temperature is worth",
    ablation.PLANES: "The planes of the room are worth",
    ablation.BEFORE: "Tracking (the labels of the frame before) is worth",
    ablation.REFINED: "The suit network is ahead of `predict`, refined, by",
    NETWORKS[ablation.SUIT]: "Without the suit's colours, the suit network is behind `predict` by",
}
"""Beginning of the sentence on a row."""
NOTHING = "nothing beyond chance"


def inputs(seed: int) -> Rows:
    """Measure the suit network without each of its inputs: 24 frames of eight people a difficulty."""
    jobs = [(difficulty, seed + number) for number, difficulty in enumerate(DIFFICULTIES)]
    rows: dict[str, dict[str, Figure]] = {}
    for found in each(_recording, jobs, DIFFICULTIES):
        rows = {name: rows.get(name, {}) | row for name, row in found.items()}
    return rows


def _recording(job: tuple[str, int]) -> dict[str, dict[str, Figure]]:
    difficulty, seed = job
    with simulated(VirtualRig(FRAMES, PEOPLE, difficulty, seed, RigOptions(cast=JUDGE))) as (folder, _, _):
        return rows_of(dict(ablation.measured(folder / "session.mcap")), difficulty)


def rows_of(found: Mapping[str, Found], difficulty: str) -> dict[str, dict[str, Figure]]:
    """Return the scores with all inputs, and each row's changes with paired intervals over people."""
    whole = found[ablation.ALL]
    scores = {heading: Figure(float(whole.scored.scores[score])) for score, (heading, _) in SHOWN.items()}
    rows = {name: _changes(whole, without) for name, without in found.items()}
    rows[ablation.ALL] = scores | {SECONDS: Figure(whole.mean_s)}
    for name, title in NETWORKS.items():
        rows[title] = _changes(found[ablation.PREDICT], found[name])
    return {
        name: {f"{heading}, `{difficulty}`": row[heading] for heading in SPECS} for name, row in rows.items()
    }


def _changes(whole: Found, without: Found) -> dict[str, Figure]:
    return {heading: Figure(*three) for heading, three in changes(whole, without).items()}


def conclusion(rows: Rows) -> str:
    """Return a sentence on each input's worth, from the changes that differ from 0 by more than chance."""
    lines = []
    for name, subject in SUBJECTS.items():
        said = {of: worth(rows[name], of) for of in DIFFICULTIES}
        parts = [f"at `{of}` {words}" for of, words in said.items()]
        lines.append(f"- {subject}: {NOTHING if set(said.values()) == {NOTHING} else '; '.join(parts)}.")
    return "\n".join(lines)


def worth(row: Mapping[str, Figure], difficulty: str) -> str:
    """Return the losses of a row in words; a gain has a minus."""
    said = []
    for heading, spec in SPECS.items():
        change = row[f"{heading}, `{difficulty}`"]
        if change.low <= 0 <= change.high:
            continue
        value = format(change.value if heading == SECONDS else -change.value, spec)
        said.append(f"{value} s a frame" if heading == SECONDS else f"{value} of {heading}")
    return ", ".join(said) or NOTHING
