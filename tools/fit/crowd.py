"""Bake the shipped crowd, ``synth/data/crowd.npz``: python -m tools.fit.crowd (extra ``bodies``).

``python -m tools.fit.crowd judge`` bakes the bodies of the judging cast, ``synth/data/judge/bodies.npz``.
"""

import sys
import warnings
from contextlib import redirect_stdout
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, least_squares
from scipy.stats import norm, qmc

from annotate.array_types import Float64, Int32
from synth.body.body import Body, blend
from synth.body.crowd import STEP_M
from synth.body.fit import BodyModel
from synth.data_files import shipped

PEOPLE = 28
HEIGHT_CM = {"woman": (163.0, 6.5), "man": (176.0, 7.0)}  # mean, deviation; NCD-RisC 2016, Europe, rounded
HEIGHT_ENDS_CM = (150.0, 195.0)
AGE_YEARS, BMI = (16.0, 80.0), (17.0, 38.0)
NEAR_BMI = 0.3  # more below a body mass index than this, a person is heavier than anny's heaviest
LIGHTER = 0.75  # anny's weight from which bodies grow to 1, the heaviest, and on; untuned
JUDGE_PEOPLE = 14  # bodies of the judging cast
JUDGE_AGE_YEARS = (18.0, 85.0)
JUDGE_GENDER, JUDGE_BUILD = (0.0, 0.2), (0.25, 0.8)  # anny's gender from a pole; muscle, proportions; untuned


class Sketch(NamedTuple):
    """Wanted body: anny's gender and age, height, body mass index; muscle and proportions to be near."""

    gender: float
    age: float
    height_cm: float
    bmi: float
    muscle: float = 0.45
    proportions: float = 0.5


def sketches() -> list[Sketch]:
    """Return the crowd: sexes in turn, the other numbers spread evenly (Sobol)."""
    draws = qmc.Sobol(3, seed=2).random(32)[:PEOPLE]
    bmi = _bmi(draws[:, 2])
    return [
        Sketch((0.92, 0.08)[i % 2], _age(age, AGE_YEARS), _height_cm(height, i), float(bmi[i]))
        for i, (age, height, _) in enumerate(draws)
    ]


def judge_sketches() -> list[Sketch]:
    """Return the bodies of the judging cast: other numbers, and other muscles and proportions."""
    draws = qmc.Sobol(6, seed=1717).random(16)[:JUDGE_PEOPLE]
    bmi, ranks = _bmi(draws[:, 2]), np.argsort(np.argsort(draws[:, 0])) / (JUDGE_PEOPLE - 1)
    people = []
    for i, (_, height, _, sex, muscle, proportions) in enumerate(draws):
        pole = float(np.interp(sex, (0, 1), JUDGE_GENDER))
        gender, age = (1 - pole, pole)[i % 2], _age(float(ranks[i]), JUDGE_AGE_YEARS)
        build = (float(np.interp(share, (0, 1), JUDGE_BUILD)) for share in (muscle, proportions))
        people.append(Sketch(gender, age, _height_cm(height, i), float(bmi[i]), *build))
    return people


def _bmi(draws: Float64) -> Float64:
    """Return a body mass index for each draw (n,), evenly spread over the logarithm by rank."""
    ranks = np.argsort(np.argsort(draws))
    return np.asarray(np.exp(np.interp(ranks, (0, len(draws) - 1), np.log(BMI))))


def _age(share: float, years: tuple[float, float]) -> float:
    """Return anny's number of an age: child (10) at 1/3, young (25) at 2/3, old (90) at 1."""
    return float(np.interp(np.interp(share, (0, 1), years), (10, 25, 90), (1 / 3, 2 / 3, 1)))


def _height_cm(share: float, number: int) -> float:
    mean, deviation = HEIGHT_CM[("woman", "man")[number % 2]]
    return float(np.clip(norm.ppf(share, mean, deviation), *HEIGHT_ENDS_CM))


def fitted(model: BodyModel, sketch: Sketch) -> Float64:
    """Return phenotypes (6,) nearest to a sketch's height and BMI, then to its muscle and proportions."""
    kg = sketch.bmi * (sketch.height_cm / 100) ** 2

    def whole(free: Float64) -> Float64:
        muscle, weight, height, proportions = free
        return np.array([sketch.gender, sketch.age, muscle, weight, height, proportions])

    def residuals(free: Float64) -> Float64:
        cm, found, _ = model.measure(whole(free))
        build = (free[0] - sketch.muscle, free[3] - sketch.proportions)
        return np.array([cm - sketch.height_cm, found - kg, *build])

    starts = ((muscle, 0.5, 0.45, 0.5) for muscle in (0.15, 0.55))
    solved = [least_squares(residuals, x, bounds=(0, 1), diff_step=1e-3, max_nfev=25) for x in starts]
    return whole(min(solved, key=lambda result: result.cost).x)


def beyond_anny(model: BodyModel, phenotype: Float64, height_cm: float, bmi: float) -> tuple[Float64, float]:
    """Return phenotypes (6,) and an extrapolation factor for a height and a BMI; 0 within anny's range."""
    cm, kg, _ = model.measure(phenotype)
    if kg / (cm / 100) ** 2 > bmi - NEAR_BMI:
        return phenotype, 0.0
    heaviest = phenotype.copy()
    heaviest[3] = 1.0

    def short_cm(height: float) -> float:
        heaviest[4] = height
        return float(model.measure(heaviest)[0] - height_cm)

    heaviest[4] = brentq(short_cm, 0, 1, xtol=1e-3)

    def short_bmi(beyond: float) -> float:
        body = baked(model, "", heaviest, beyond)
        return body.weight_kg / (body.height_cm / 100) ** 2 - bmi

    return heaviest, float(brentq(short_bmi, 0, 1, xtol=1e-3))


def lighter(phenotype: Float64) -> Float64:
    """Return the same person's phenotypes (6,) at weight ``LIGHTER``."""
    return np.where(np.arange(6) == 3, LIGHTER, phenotype)


def baked(model: BodyModel, name: str, phenotype: Float64, beyond: float) -> Body:
    """Return the body of phenotypes (6,), extrapolated in weight by the factor ``beyond``."""
    body = model.bake(name, phenotype)
    return blend(model.bake(name, lighter(phenotype)), body, 1 + beyond) if beyond else body


def base_mesh(model: BodyModel, phenotype: Float64, beyond: float) -> Float64:
    """Return vertices (19158, 3) of anny's full mesh (hm08), as by ``baked``. model: of that mesh."""
    vertices = model.shape(phenotype)[0]
    return vertices + beyond * (vertices - model.shape(lighter(phenotype))[0]) if beyond else vertices


def main() -> None:
    judge = sys.argv[1:] == ["judge"]
    wanted, name = (judge_sketches(), "judge") if judge else (sketches(), "crowd")
    with redirect_stdout(sys.stderr):
        import anny

        model = BodyModel()
        people = [beyond_anny(model, fitted(model, s), s.height_cm, s.bmi) for s in wanted]
        bodies = [baked(model, f"{name}_{i:02}", *person) for i, person in enumerate(people)]
        for sketch, (phenotype, beyond), body in zip(wanted, people, bodies, strict=True):
            bmi = body.weight_kg / (body.height_cm / 100) ** 2
            found = f"{body.height_cm:.1f} cm, BMI {bmi:.1f}"
            print(np.round(sketch, 2), np.round(phenotype, 2), round(beyond, 2), found, flush=True)
        if judge:
            save(shipped("judge", "bodies.npz"), bodies, np.zeros((len(bodies), 0, 3)))
            return
        skin = model._model.base_mesh_vertex_indices.numpy()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # all vertices of hm08, helpers too
            model._model = anny.create_fullbody_model(remove_unattached_vertices=False)
        base = np.array([base_mesh(model, *person) for person in people])
    # Bodies stand on the floor, shapes about anny's origin.
    base -= (base[:, skin].mean(axis=1) - np.array([b.vertices_m[: len(skin)].mean(axis=0) for b in bodies]))[
        :, None
    ]
    helpers = np.setdiff1d(np.arange(base.shape[1]), skin)
    indices = {"skin": skin.astype(np.int32), "helpers": helpers.astype(np.int32)}
    save(shipped("crowd.npz"), bodies, base[:, helpers], **indices)


def save(path: Path, bodies: list[Body], helpers_m: Float64, **indices: Int32) -> None:
    """Write bodies of the crowd's mesh and their helpers (n, H, 3), in steps of ``STEP_M``.

    The file holds a mean (V, 3) and differences (n, 3, V), which pack better than (n, V, 3).
    """
    vertices = np.rint(np.concatenate([[body.vertices_m for body in bodies], helpers_m], axis=1) / STEP_M)
    mean = np.rint(vertices.mean(axis=0)).astype(np.int16)
    differences = (vertices - mean).astype(np.int16).swapaxes(1, 2).copy()
    joints_m = np.array([body.joints_m for body in bodies])
    np.savez_compressed(path, mean=mean, differences=differences, joints_m=joints_m, **indices)


if __name__ == "__main__":
    main()
