"""Hearts of the atlas, for recordings of people of whom there is no image.

The hearts have the mesh of one template, so that a vertex is the same place in each. Each lies in a
torso of its own, and has its own size, shape, position and electrodes (`fascicle.atlas`).
"""

from __future__ import annotations

import json
import os
import zipfile
from dataclasses import fields as dataclass_fields
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.files import DISPOSABLE, ArrayCache
from fascicle.heart.coordinates import ventricular_coordinates
from fascicle.heart.fibres import rule_based_fibres
from fascicle.heart.heart import Atlas, Components, Heart
from fascicle.heart.labelled_surface import labelled_mesh


def atlas_heart(heart: Heart, number: int) -> Heart:
    """One heart of an atlas, with fibres by rule and its electrodes, without lead fields.

    `Atlas.lead_fields` are those of the heart with its tissue.
    """
    atlas = heart.atlas
    assert atlas is not None
    vertices = atlas.vertices(number)
    fibre, sheet = _fibres(heart, number, vertices)
    bare = with_bare_base(heart, atlas.network_heights[number])
    lv, rv = (
        replace(e, vertices=vertices[numbers], root=int(root), direction=int(direction))
        for e, numbers, (root, direction) in zip(
            bare.endocardia, endocardial_vertices(heart), atlas.seeds[number], strict=True
        )
    )
    return replace(
        heart, vertices=vertices, fibres=fibre, sheets=sheet, lv=lv, rv=rv,
        electrodes=atlas.electrodes[number], name=f"{heart.name} {number}", torso=None, atlas=None,
        lead_fields=None, folder=None,
    )  # fmt: skip


def with_bare_base(heart: Heart, height: float) -> Heart:
    """Heart without Purkinje fibres in the free walls above a height: 0 the apex, 1 the base."""
    coordinates = ventricular_coordinates(heart)
    # the septum has rotational coordinates above 2/3
    basal = (coordinates.apicobasal > height) & (coordinates.rotational <= 2 / 3)
    tree = cKDTree(heart.vertices)
    bare = [basal[tree.query(e.vertices)[1]][e.triangles].all(axis=1) for e in heart.endocardia]
    return replace(heart, lv=replace(heart.lv, bare=bare[0]), rv=replace(heart.rv, bare=bare[1]))


def _fibres(heart: Heart, number: int, vertices: Floats) -> tuple[Floats, Floats]:
    """Fibres and sheets (m, 3) of a heart of an atlas, by rule; kept in the cache of the atlas."""
    cache = None
    if heart.folder is not None and os.access(heart.folder, os.W_OK):
        cache = ArrayCache(heart.folder / DISPOSABLE, "fibres")
    arrays = None if cache is None else cache.read(f"{heart.digest} {number}")
    if arrays is None:
        ruled = rule_based_fibres(replace(labelled_mesh(heart), vertices=vertices))
        arrays = {"fibre": ruled.fibre, "sheet": ruled.sheet}
        if cache is not None:
            cache.keep(f"{heart.digest} {number}", arrays)
    return arrays["fibre"], arrays["sheet"]


def endocardial_vertices(heart: Heart) -> list[Integers]:
    """Vertices of the mesh that are those of the left and the right endocardium."""
    tree, numbers = cKDTree(heart.vertices), []
    for e in heart.endocardia:
        distance, nearest = tree.query(e.vertices)
        if distance.max() > 1e-3:  # mm; room for single precision
            raise InputError(f"{heart.name}: the endocardia are not parts of the mesh")
        numbers.append(np.asarray(nearest, dtype=np.int64))
    return numbers


def write_atlas(atlas: Atlas, path: Path) -> None:
    """Write an atlas."""
    parts = {"shapes": atlas.shapes, "fields": atlas.fields}
    arrays = {f"{name} {key}": a for name, part in parts.items() for key, a in vars(part).items()}
    arrays |= {f"measure {name}": values for name, values in atlas.measures.items()}
    arrays |= {f"person {name}": np.array(value) for name, value in atlas.person.items()}
    tissues = np.array(json.dumps([dict(tissue) for tissue in atlas.tissues]))
    arrays |= {"electrodes": atlas.electrodes, "seeds": atlas.seeds, "tissues": tissues}
    arrays |= {"network_heights": atlas.network_heights, "weights": atlas.weights}
    np.savez_compressed(path, allow_pickle=False, **arrays)


def read_atlas(path: Path) -> Atlas:
    """Read an atlas from the file in a heart's folder; an error if it is none."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
        shapes, fields = (
            Components(*(arrays[f"{name} {part.name}"] for part in dataclass_fields(Components)))
            for name in ("shapes", "fields")
        )
        measures, person = (
            {
                name.removeprefix(prefix): values
                for name, values in arrays.items()
                if name.startswith(prefix)
            }
            for prefix in ("measure ", "person ")
        )
        return Atlas(
            shapes,
            arrays["electrodes"],
            arrays["seeds"],
            arrays["network_heights"],
            fields,
            tuple(json.loads(str(arrays["tissues"]))),
            measures,
            arrays["weights"],
            {name: float(value) for name, value in person.items()},
        )
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        raise InputError(f"{path}: not an atlas of hearts; install fascicle again") from None
