"""Garments of MakeHuman's base mesh hm08 (``.mhclo`` and ``.obj`` files) on any body.

The package contains no garments. Format: makehuman/shared/proxy.py.
"""

from dataclasses import dataclass
from itertools import dropwhile, pairwise, takewhile
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from annotate.array_types import Bool, Float32, Float64, Int32, Int64, UInt8
from sensors.errors import CloudError, FormatError, fault_of
from sensors.files.bounded import read_bounded
from synth.body.body import BONES_PER_VERTEX, Body, hair_faces
from synth.body.crowd import BASE_VERTICES, base_mesh_m, covered_skin
from synth.body.skeleton import JOINT_ID, N_JOINTS
from synth.clothes.cloth import smooth_normals
from synth.clothes.dressed import Dressed, assembled

BASE_MESH = "hm08"
MAX_FILE_BYTES = 100_000_000  # MakeHuman's largest has 2 MB
SKIN_NEIGHBOURS = 6  # skin vertices whose mean moves a garment's vertex; untuned
WORN = {"clothes": 1.0, "shoes": 0.7, "hair": 0.8}  # share of people with a garment of each kind; untuned
DRAWN_IN_M = 0.012  # of covered skin, so that it does not show; untuned
SHOE_M, CROWN_M = 0.35, 0.10  # top of shoes; least height of hair over the head's joint; untuned


@dataclass(frozen=True, eq=False)
class Garment:
    """Garment bound to hm08.

    corners: (n, 3) vertices of hm08 to which each vertex is bound, with shares (n, 3). offsets: (n, 3) in the
    file's units; x left, y up, z forward. spans: (3, 3), for each axis two vertices of hm08 and their
    distance in the file's units. hidden: (19158,) covered vertices of hm08.
    """

    name: str
    corners: Int32
    shares: Float64
    offsets: Float64
    spans: Float64
    faces: Int32
    hidden: Bool

    def place(self, base_m: Float32) -> Float32:
        """Return the garment's vertices (n, 3), metres, on a body at rest with hm08's vertices (19158, 3)."""
        pairs = base_m[self.spans[:, :2].astype(int)]
        # The file's x, y, z are the body's x, z, -y.
        axes = np.array([0, 2, 1])
        scale = np.abs(pairs[np.arange(3), 0, axes] - pairs[np.arange(3), 1, axes]) / self.spans[:, 2]
        x, y, z = (self.offsets * scale).T
        on_skin = np.einsum("nk,nkd->nd", self.shares, base_m[self.corners].astype(np.float64))
        return np.asarray(on_skin + np.stack([x, -z, y], axis=1), np.float32)


def read_garments(folder: Path) -> tuple[Garment, ...]:
    """Read every ``.mhclo`` file of a folder and its subfolders. Raises CloudError if there is none."""
    paths = sorted(folder.rglob("*.mhclo"))
    if not paths:
        raise CloudError(f"{folder} has no .mhclo garment; give a folder of MakeHuman's clothes")
    return tuple(read_garment(path) for path in paths)


def read_garment(path: Path) -> Garment:
    """Read a ``.mhclo`` file and its ``.obj`` file.

    Raises FormatError for damaged files, files that do not match, and another base mesh.
    """
    try:
        return _parse(path, _text(path))
    except (ValueError, IndexError, KeyError) as error:
        raise FormatError(f"{path} is not a garment ({fault_of(error)[:120]}); export it again") from error


def _text(path: Path) -> list[str]:
    return read_bounded(path, MAX_FILE_BYTES, "export it again").decode("utf-8", "replace").splitlines()


def _parse(path: Path, lines: list[str]) -> Garment:
    words = [line.split() for line in lines if line.strip() and not line.startswith("#")]
    head = {row[0]: row[1:] for row in words}
    if head.get("basemesh") != [BASE_MESH]:
        mesh = " ".join(head.get("basemesh", ["no named mesh"]))
        raise FormatError(f"{path} is made for {mesh[:40]}; give garments for {BASE_MESH}")
    after = words[next(i for i, row in enumerate(words) if row[0] == "verts") + 1 :]
    numbers = takewhile(lambda row: row[0].isdigit(), dropwhile(lambda row: not row[0].isdigit(), after))
    rows = [[float(v) for v in (row if len(row) > 1 else [*row * 3, 1, *"00000"])] for row in numbers]
    table = np.array(rows).reshape(-1, 9)
    spans = np.array([[float(v) for v in head[f"{axis}_scale"]] for axis in "xyz"])
    ids = np.concatenate([table[:, :3].ravel(), spans[:, :2].ravel()])
    if not len(table) or not np.isfinite(table).all() or (spans[:, 2] <= 0).any():
        raise ValueError("malformed numbers, or a scale that is not positive")
    if ids.min() < 0 or ids.max() >= BASE_VERTICES:
        raise ValueError(f"vertices beyond the {BASE_VERTICES} of {BASE_MESH}")
    # A name only, so that other folders are not read.
    faces = _faces(path.parent / Path(head["obj_file"][0]).name, len(table))
    return Garment(
        path.stem, table[:, :3].astype(np.int32), table[:, 3:6], table[:, 6:], spans, faces, _hidden(words)
    )


def _hidden(words: list[list[str]]) -> Bool:
    """Return flags (19158,) of the vertices under ``delete_verts``: numbers, and ranges as FIRST - LAST."""
    hidden = np.zeros(BASE_VERTICES, np.bool_)
    start = next((i + 1 for i, row in enumerate(words) if row[0] == "delete_verts"), len(words))
    tokens = [t for row in takewhile(lambda row: row[0].isdigit(), words[start:]) for t in row]
    for before, token, after in zip(["", *tokens], tokens, [*tokens[1:], ""], strict=False):
        if token == "-":
            hidden[int(before) : int(after) + 1] = True
        else:
            hidden[int(token)] = True
    return hidden


def _faces(path: Path, n_vertices: int) -> Int32:
    """Return the triangles (F, 3) of an ``.obj`` file; polygons are cut into fans."""
    triangles = []
    for line in _text(path):
        if line.startswith("f "):
            corners = [int(corner.split("/")[0]) - 1 for corner in line.split()[1:]]
            triangles += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
    faces = np.array(triangles, np.int32).reshape(-1, 3)
    if not len(faces) or faces.min() < 0 or faces.max() >= n_vertices:
        raise ValueError(f"faces of {path.name} do not belong to {n_vertices} vertices")
    return faces


def kind_of(garment: Garment, body: Body) -> str:
    """Return the kind of a garment, a key of ``WORN``, from the garment's greatest height on a body."""
    z = garment.place(base_mesh_m(body))[:, 2]
    if z.max() < SHOE_M:
        return "shoes"
    return "hair" if z.max() > body.joints_m[JOINT_ID["head"], 2] + CROWN_M else "clothes"


def choose(garments: tuple[Garment, ...], body: Body, rng: np.random.Generator) -> list[Garment]:
    """Draw at most one garment of each kind, with the probabilities ``WORN``."""
    kinds = [kind_of(garment, body) for garment in garments]
    chosen = []
    for kind in WORN:
        own = [g for g, its in zip(garments, kinds, strict=True) if its == kind]
        if own and rng.random() < WORN[kind]:
            chosen.append(own[int(rng.integers(len(own)))])
    return chosen


def wear(body: Body, garments: list[Garment]) -> Dressed:
    """Return a body in garments; garment vertices and two-sided faces come after the body's own.

    Garments take skinning weights and parts of the nearest skin.
    """
    base = base_mesh_m(body)
    skin = _inwards(body, np.logical_or.reduce([g.hidden for g in garments]))
    vertices, faces, parts, dark = [skin], [body.faces], [body.face_parts], [hair_faces(body)]
    bones, weights = [body.bones], [body.weights]
    outer = np.flatnonzero(body.vertex_parts > 0)
    tree = cKDTree(body.vertices_m[outer])
    count = len(skin)
    for garment in garments:
        own = garment.place(base)
        near = outer[tree.query(own, SKIN_NEIGHBOURS)[1]]
        moved_by, shares = _mean_influences(body, near)
        centres = outer[tree.query(own[garment.faces].mean(axis=1))[1]]
        both_sides = np.concatenate([garment.faces, garment.faces[:, ::-1]]) + np.int32(count)
        vertices.append(own)
        faces.append(both_sides)
        parts.append(np.tile(body.vertex_parts[centres], 2))
        bones.append(moved_by)
        weights.append(shares)
        dark.append(np.full(len(both_sides), kind_of(garment, body) == "hair"))
        count += len(own)
    whole = np.concatenate(vertices)
    # Soles are below the skin's.
    lift = np.array([0, 0, -whole[:, 2].min()], np.float32)
    worn = Body(
        body.name,
        whole + lift,
        np.concatenate(faces),
        np.concatenate(parts),
        body.joints_m + lift,
        np.concatenate(bones),
        np.concatenate(weights),
        body.waist,
    )
    return assembled(worn, np.concatenate(dark), clothes=[garment.name for garment in garments])


def _inwards(body: Body, hidden: Bool) -> Float32:
    """Return the rest vertices (V, 3); those under a garment are moved inwards along their normals."""
    covered = covered_skin(body, hidden)
    return np.where(
        covered[:, None], body.vertices_m - np.float32(DRAWN_IN_M) * smooth_normals(body), body.vertices_m
    )


def _mean_influences(body: Body, near: Int64) -> tuple[UInt8, Float32]:
    n = len(near)
    by_joint = np.zeros((n, N_JOINTS), np.float32)
    rows = np.repeat(np.arange(n), near.shape[1] * BONES_PER_VERTEX)
    np.add.at(by_joint, (rows, body.bones[near].ravel()), body.weights[near].ravel())
    bones = np.argsort(-by_joint, axis=1, kind="stable")[:, :BONES_PER_VERTEX]
    weights = np.take_along_axis(by_joint, bones, axis=1)
    return bones.astype(np.uint8), weights / weights.sum(axis=1, keepdims=True)
