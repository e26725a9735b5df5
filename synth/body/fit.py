"""Fit anny's parametric body to height, weight and waist breadth, and bake it. Needs the extra ``bodies``."""

from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import qmc

from annotate.array_types import Float32, Float64, UInt8
from sensors.errors import CloudError
from synth.body.body import BONES_PER_VERTEX, DENSITY_KG_M3, Body, volume_m3
from synth.body.body_table import BodySize
from synth.body.part_border import PartSkin, cut_into_parts
from synth.body.skeleton import JOINT_ID, JOINTS, N_JOINTS, Joint
from synth.data_files import table

PHENOTYPES = ("gender", "age", "muscle", "weight", "height", "proportions")
ADULT_AGE = 0.5  # anny's age: newborn 0, 25 years 2/3, old 1; below 0.5 are children
AVERAGE = np.array([0.5, 0.67, 0.5, 0.5, 0.5, 0.5])  # young adult of no sex
_NEAR = 0.5  # cm and kg; largest misfit of a measure, far above Table 1's; untuned


class BodyModel:
    """Body model anny at rest, as a function of six phenotypes (shape parameters)."""

    def __init__(self) -> None:
        try:
            import anny
            import torch
        except ImportError as error:
            raise CloudError("fitting bodies needs anny; pip install 'annotate-cloud[bodies]'") from error
        self._torch: Any = torch
        self._model: Any = anny.Anny()
        self.faces = self._model.faces.numpy().astype(np.int32)
        self.waist = np.array(anny.Anthropometry(self._model).waist_vertex_indices, np.int32)

    def shape(self, phenotype: Float64) -> tuple[Float64, Float64]:
        """Return vertices (V, 3) and bone heads (B, 3), metres, of a body with phenotypes (6,) in [0, 1]."""
        model = self._model
        with self._torch.no_grad():
            numbers = (self._torch.tensor([v], dtype=model.dtype) for v in phenotype)
            values = dict(zip(PHENOTYPES, numbers, strict=True))
            coefficients = model.get_phenotype_blendshape_coefficients(**values)[0]
            used = self._torch.nonzero(coefficients)[:, 0]
            vertices, heads = (
                template + self._torch.einsum("k,kvd->vd", coefficients[used], shapes[used])
                for template, shapes in (
                    (model.template_vertices, model.blendshapes),
                    (model.template_bone_heads, model.bone_heads_blendshapes),
                )
            )
        return vertices.numpy().astype(np.float64), heads.numpy().astype(np.float64)

    def measure(self, phenotype: Float64) -> Float64:
        """Return height in cm, weight in kg and waist breadth in cm (3,) of phenotypes (6,)."""
        vertices, _ = self.shape(phenotype)
        height, breadth = np.ptp(vertices[:, 2]), np.ptp(vertices[self.waist, 0])
        return np.array([100 * height, DENSITY_KG_M3 * volume_m3(vertices, self.faces), 100 * breadth])

    def bake(self, name: str, phenotype: Float64) -> Body:
        vertices, joints = self._standing(phenotype)
        bones, weights = self._influences
        recipe, faces, face_parts = self._skin
        skin = (recipe @ vertices).astype(np.float32)
        return Body(name, skin, faces, face_parts, joints, bones, weights, self.waist)

    @cached_property
    def _influences(self) -> tuple[UInt8, Float32]:
        """Return the strongest influences on each vertex of the cut skin, joints and weights, equal for all
        bodies.
        """
        by_joint = self._skin.recipe @ self._weights_by_joint(self._skin.recipe.shape[1])
        bones = np.argsort(-by_joint, axis=1, kind="stable")[:, :BONES_PER_VERTEX]
        weights = np.take_along_axis(by_joint, bones, axis=1)
        weights /= weights.sum(axis=1, keepdims=True)
        return bones.astype(np.uint8), weights.astype(np.float32)

    @cached_property
    def _skin(self) -> PartSkin:
        """Return the average body's skin, cut along part borders; all bodies share its topology, so that any
        two can be blended.
        """
        vertices, joints = self._standing(AVERAGE)
        return cut_into_parts(vertices, self.faces, joints, self._weights_by_joint(len(vertices)))

    def _standing(self, phenotype: Float64) -> tuple[Float64, Float64]:
        vertices, heads = self.shape(phenotype)
        joints = np.stack([heads[self._model.bone_labels.index(_head_bone(j))] for j in JOINTS])
        floor = np.array([0.0, 0.0, vertices[:, 2].min()])
        return vertices - floor, joints - floor

    def _weights_by_joint(self, n_vertices: int) -> Float32:
        joint_of_bone = np.array([_joint_of(label) for label in self._model.bone_labels])
        indices = joint_of_bone[self._model.vertex_bone_indices.numpy()]
        by_joint = np.zeros((n_vertices, N_JOINTS), np.float32)
        rows, weights = np.arange(n_vertices)[:, None], self._model.vertex_bone_weights.numpy()
        np.add.at(by_joint, (rows, indices), weights)
        return by_joint


def _joint_of(bone: str) -> int:
    stem, _, side = bone.partition(".")
    kind = next(k for k, entry in table("joints").items() if stem.startswith(tuple(entry["bones"])))
    return JOINT_ID[kind if kind in JOINT_ID else f"{'left' if side == 'L' else 'right'}_{kind}"]


def _head_bone(joint: Joint) -> str:
    bone: str = table("joints")[joint.kind]["head"]
    return bone if joint.kind == joint.name else f"{bone}.{joint.name[0].upper()}"


def fit(model: BodyModel, size: BodySize, starts: int = 8) -> Float64:
    """Fit phenotypes (6,) to measures by bounded least squares from several starts.

    A weak prior at the middle of every phenotype decides what the measures leave open. Raises CloudError when
    no adult has these measures.
    """
    asked = np.array([size.height_cm, size.weight_kg, size.waist_breadth_cm])
    low = np.array([0.0, ADULT_AGE, 0.0, 0.0, 0.0, 0.0])

    def residuals(phenotype: Float64) -> Float64:
        return np.concatenate([model.measure(phenotype) - asked, 0.05 * (phenotype - AVERAGE)])

    best, cost = AVERAGE, np.inf
    for start in qmc.scale(qmc.Sobol(6, seed=0).random(starts), low, np.ones(6)):
        result = least_squares(residuals, start, bounds=(low, np.ones(6)), diff_step=1e-3, max_nfev=60)
        if result.cost < cost:
            best, cost = result.x, float(result.cost)
        if np.abs(residuals(result.x)[:3]).max() < 0.1:
            break
    nearest = model.measure(best)
    if np.abs(nearest - asked).max() > _NEAR:
        found = "{:.1f} cm, {:.1f} kg, waist {:.1f} cm".format(*nearest)
        raise CloudError(
            f"body {size.name}: no adult has these measures; the nearest has {found}; give similar ones"
        )
    return best


def random_adult(rng: np.random.Generator) -> Float64:
    """Draw phenotypes (6,) of an adult of either sex.

    anny's default adult is tall and light. Therefore the phenotypes of height and weight are drawn about 0.4
    and 0.72. Heights are then 170 +- 10 cm and body mass indices 22 +- 3, about as for real adults.
    """
    gender = np.clip(rng.choice((0.1, 0.9)) + rng.normal(0, 0.08), 0, 1)
    age = rng.uniform(0.6, 0.97)
    muscle_weight_height_proportions = rng.normal((0.5, 0.72, 0.4, 0.5), (0.18, 0.26, 0.08, 0.2))
    return np.array([gender, age, *np.clip(muscle_weight_height_proportions, 0.05, 0.95)])
