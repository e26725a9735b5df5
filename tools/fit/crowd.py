"""Bake the shipped crowd, ``synth/data/crowd.npz``: python -m tools.fit.crowd (extra ``bodies``)."""

import sys
import warnings
from contextlib import redirect_stdout
from typing import Any

import numpy as np
from scipy.optimize import brentq, least_squares
from scipy.stats import qmc

from annotate.array_types import Float64, Int64
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


def sketches() -> list[tuple[float, float, float, float]]:
    """Return (gender, age, height cm, BMI) of all: sexes in turn, the others spread evenly (Sobol)."""
    from scipy.stats import norm

    draws = qmc.Sobol(3, seed=2).random(32)[:PEOPLE]
    ranks = np.argsort(np.argsort(draws[:, 2]))
    bmi = np.exp(np.interp(ranks, (0, PEOPLE - 1), np.log(BMI)))
    people = []
    for i, (age, height, _) in enumerate(draws):
        sex = ("woman", "man")[i % 2]
        mean, deviation = HEIGHT_CM[sex]
        cm = float(np.clip(norm.ppf(height, mean, deviation), *HEIGHT_ENDS_CM))
        gender = 0.92 if sex == "woman" else 0.08
        people.append((gender, anny_age(float(np.interp(age, (0, 1), AGE_YEARS))), cm, float(bmi[i])))
    return people


def anny_age(years: float) -> float:
    """Return anny's number of an age: child (10) at 1/3, young (25) at 2/3, old (90) at 1."""
    return float(np.interp(years, (10, 25, 90), (1 / 3, 2 / 3, 1)))


def fitted(model: BodyModel, gender: float, age: float, height_cm: float, bmi: float) -> Float64:
    """Return phenotypes (6,) nearest to a height and a BMI; muscle and proportions near the middle."""
    kg = bmi * (height_cm / 100) ** 2

    def whole(free: Float64) -> Float64:
        muscle, weight, height, proportions = free
        return np.array([gender, age, muscle, weight, height, proportions])

    def residuals(free: Float64) -> Float64:
        cm, found, _ = model.measure(whole(free))
        return np.array([cm - height_cm, found - kg, free[0] - 0.45, free[3] - 0.5])

    best = min(
        (
            least_squares(residuals, (muscle, 0.5, 0.45, 0.5), bounds=(0, 1), diff_step=1e-3, max_nfev=25)
            for muscle in (0.15, 0.55)
        ),
        key=lambda result: result.cost,
    )
    return whole(best.x)


def beyond_anny(model: BodyModel, phenotype: Float64, height_cm: float, bmi: float) -> tuple[Float64, float]:
    """Return phenotypes (6,), and steps beyond them to a height and a BMI; 0 within anny."""
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
    result = phenotype.copy()
    result[3] = LIGHTER
    return result


def baked(model: BodyModel, name: str, phenotype: Float64, beyond: float) -> Body:
    """Return the body of phenotypes (6,), so far beyond them."""
    body = model.bake(name, phenotype)
    return blend(model.bake(name, lighter(phenotype)), body, 1 + beyond) if beyond else body


def full_mesh(anny: Any) -> Any:
    """Return anny with all vertices of hm08, helpers too."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return anny.create_fullbody_model(remove_unattached_vertices=False)


def base_mesh(model: BodyModel, phenotype: Float64, beyond: float) -> Float64:
    """Return vertices (19158, 3) of hm08 of phenotypes (6,), so far beyond; ``model`` has the full mesh."""
    vertices = model.shape(phenotype)[0]
    return vertices + beyond * (vertices - model.shape(lighter(phenotype))[0]) if beyond else vertices


def main() -> None:
    with redirect_stdout(sys.stderr):
        import anny

        model = BodyModel()
        people = [beyond_anny(model, fitted(model, *sketch), *sketch[2:]) for sketch in sketches()]
        bodies = [baked(model, f"crowd_{i:02}", *person) for i, person in enumerate(people)]
        for sketch, (phenotype, beyond), body in zip(sketches(), people, bodies, strict=True):
            bmi = body.weight_kg / (body.height_cm / 100) ** 2
            found = f"{body.height_cm:.1f} cm, BMI {bmi:.1f}"
            print(np.round(sketch, 2), np.round(phenotype, 2), round(beyond, 2), found, flush=True)
        skin = model._model.base_mesh_vertex_indices.numpy()
        model._model = full_mesh(anny)
        base = np.array([base_mesh(model, *person) for person in people])
    # Bodies stand on the floor, shapes about anny's origin.
    base -= (base[:, skin].mean(axis=1) - np.array([b.vertices_m[: len(skin)].mean(axis=0) for b in bodies]))[
        :, None
    ]
    save_crowd(bodies, base, skin)


def save_crowd(bodies: list[Body], base: Float64, skin: Int64) -> None:
    """Write the crowd: vertices and helpers of hm08 in steps of ``STEP_M``: a mean (V, 3) and differences
    (n, 3, V), which pack better than (n, V, 3).

    base: (n, 19158, 3) hm08 about each body; skin: its vertices that are the first of a body's own.
    """
    helpers = np.setdiff1d(np.arange(base.shape[1]), skin)
    own = np.array([body.vertices_m for body in bodies])
    vertices = np.rint(np.concatenate([own, base[:, helpers]], axis=1) / STEP_M)
    mean = np.rint(vertices.mean(axis=0)).astype(np.int16)
    np.savez_compressed(
        shipped("crowd.npz"), mean=mean,
        differences=(vertices - mean).astype(np.int16).swapaxes(1, 2).copy(),
        joints_m=np.array([body.joints_m for body in bodies]),
        skin=skin.astype(np.int32), helpers=helpers.astype(np.int32),
    )  # fmt: skip


if __name__ == "__main__":
    main()
