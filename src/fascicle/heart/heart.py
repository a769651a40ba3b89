"""Heart as input of the forward model, and the torso around it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import igl
import numpy as np
from numpy.typing import NDArray

from fascicle.core import above, html_card
from fascicle.core.arrays import Floats, Integers
from fascicle.core.files import as_path
from fascicle.core.leads import ELECTRODES, LEADS, additional_leads
from fascicle.core.ranges import short_repr
from fascicle.heart.action_potential import TabulatedPotential
from fascicle.heart.endocardium import Endocardium
from fascicle.mesh.measures import edge_lengths, signed_volumes
from fascicle.mesh.topology import boundary_triangles
from fascicle.mesh.vtk import pyvista_grid


class TorsoTissue(IntEnum):
    """Tissue of a tetrahedron outside the myocardium."""

    OTHER = 1  # muscle, fat and skin
    LUNG = 2
    BLOOD = 3


@dataclass(frozen=True)
class Torso:
    """A conforming mesh of everything outside the myocardium.

    Vertices (k, 3) (mm), of which the first are all those of the heart, in its order; tetrahedra
    (m, 4), positively oriented, without the myocardium's own; and a `TorsoTissue` for each (m,).
    """

    vertices: Floats
    tetrahedra: Integers
    tissues: Integers

    __repr__ = short_repr


@dataclass(frozen=True)
class LeadFields:
    """Lead fields at the heart's vertices (kΩ), up to a constant, and their origin.

    A row (9 + a, n) for each of the heart's electrodes, in the order of `Heart.electrode_names`.
    `key` is `fascicle.torso.lead_fields.key_of` heart and conduction, `torso` is `torso_key`,
    or `fascicle.torso.idealised.FITTED` where that torso is not in the folder.
    """

    values: Floats
    key: str
    torso: str

    __repr__ = short_repr


@dataclass(frozen=True)
class Components:
    """Rows (n, m) by their mean (m,), principal components (q, m) and coefficients (n, q)."""

    mean: NDArray[np.float32]
    components: NDArray[np.float16]
    coefficients: NDArray[np.float32]

    __repr__ = short_repr

    @classmethod
    def of(cls, rows: NDArray[Any], count: int) -> Components:
        """First `count` principal components of rows, in half precision."""
        mean = rows.mean(axis=0, dtype=float)
        left, sizes, components = np.linalg.svd(rows - mean, full_matrices=False)
        scale = np.abs(components[:count]).max(axis=1)
        coefficients = left[:, :count] * sizes[:count] * scale
        return cls(
            mean.astype(np.float32),
            (components[:count] / scale[:, None]).astype(np.float16),
            coefficients.astype(np.float32),
        )

    def rows(self, chosen: slice) -> Floats:
        """Some of the rows."""
        return np.asarray(self.mean + self.coefficients[chosen] @ self.components.astype(float))


@dataclass(frozen=True)
class Atlas:
    """Hearts of the population on the mesh of one heart, each in a torso of its own.

    Attributes
    ----------
    shapes : Components
        Positions (mm) of the mesh's vertices, a row (3 n,) for each heart.
    electrodes : (k, 9, 3) array
        Electrodes of each heart (mm).
    seeds : (k, 2, 2) array
        Of the left and the right endocardium of each heart: the vertices where the bundle starts,
        and that it heads for.
    network_heights : (k,) array
        Height of each heart's Purkinje networks on the free walls, from apex (0) to base (1).
    fields : Components
        Lead fields at the vertices (kΩ), up to a constant, nine rows (n,) for each heart.
    tissues : tuple of mappings
        Quantities of the tissue of each heart.
    measures : mapping of str to (k,) array
        Size and pose of each heart, and the build of the person, by name.
    weights : (k,) array
        Prior probability of each heart.
    person : mapping of str to float
        What is known of the person: sex (0 female, 1 male), age, height (cm), weight (kg).
    """

    shapes: Components
    electrodes: Floats
    seeds: Integers
    network_heights: Floats
    fields: Components
    tissues: tuple[Mapping[str, float], ...]
    measures: Mapping[str, Floats]
    weights: Floats
    person: Mapping[str, float] = field(default_factory=dict)

    __repr__ = short_repr

    def __len__(self) -> int:
        """Number of hearts."""
        return len(self.electrodes)

    def vertices(self, number: int) -> Floats:
        """Positions (n, 3) of the vertices of a heart (mm)."""
        return self.shapes.rows(slice(number, number + 1)).reshape(-1, 3)

    def lead_fields(self, number: int) -> Floats:
        """Lead fields (9, n) of a heart (kΩ)."""
        return self.fields.rows(slice(9 * number, 9 * number + 9))


@dataclass(frozen=True)
class VentricularCoordinates:
    """Ventricular coordinates of each vertex (n,), as `fascicle.heart.coordinates` defines them.

    The ventricle is 0 in the left, 1 in the right one; the others are from 0 to 1.
    """

    names: ClassVar = ("tv", "tm", "rt", "ab")  # as Cobiveco writes them
    wall: ClassVar[float] = 0.1  # thickness in `places`; the way from apex to base is 1

    ventricle: Floats
    transmural: Floats
    rotational: Floats
    apicobasal: Floats

    __repr__ = short_repr

    @property
    def arrays(self) -> dict[str, Floats]:
        """Coordinates by their names."""
        values = (self.ventricle, self.transmural, self.rotational, self.apicobasal)
        return dict(zip(self.names, values, strict=True))

    @property
    def places(self) -> Floats:
        """Positions (n, 3) in a disk for each ventricle, apex in the middle, as thick as `wall`."""
        turn = 2 * np.pi * self.rotational
        around = self.apicobasal * np.array([np.cos(turn), np.sin(turn)])
        return np.column_stack([*around, self.wall * self.transmural])


@dataclass(frozen=True)
class Heart:
    """Ventricular tissue, endocardia and electrodes, in one frame, in mm.

    Attributes
    ----------
    vertices, tetrahedra : (n, 3) and (m, 4) arrays
        Positions (mm) and vertex indices, positively oriented.
    fibres : (m, 3) array
        Unit fibre direction of each tetrahedron.
    lv, rv : Endocardium
        The two endocardia.
    electrodes : (9, 3) array
        Positions (mm), in the order of `fascicle.core.leads.ELECTRODES`.
    name : str
        Name of the heart in messages and figures.
    additional_electrodes : mapping of name to (3,) array
        Positions (mm) of electrodes besides the nine; see `fascicle.core.leads.additional_leads`.
    regions : (m,) array, optional
        A label for each tetrahedron, for `fascicle.heart.conduction.Region`.
    sheets : (m, 3) array, optional
        Unit direction in the sheet, across the fibre, of each tetrahedron; for other software.
    torso : Torso, optional
        Torso around the heart; without one the volume conductor is unbounded.
    lead_fields : LeadFields, optional
        Lead fields of the electrodes in that torso, if they were computed before.
    values : mapping of name to float
        Values of quantities (`fascicle.core.quantities`) of this patient, such as ``alpha`` or
        ``region_1_conductivity``, in place of the defaults.
    action_potential : TabulatedPotential, optional
        Action potential of the ECG, in place of the built-in one.
    coordinates : VentricularCoordinates, optional
        Ventricular coordinates of the vertices; `fascicle.ventricular_coordinates` computes them
        where they are missing.
    example : mapping of name to float
        Parameters of the example network, if the heart has its own; see
        `fascicle.example_parameters`.
    atlas : Atlas, optional
        Hearts of the population on this heart's mesh, for a person of whom there is no image.
    folder : Path, optional
        Folder of the cache of results for this heart, usually that which it was read from.
    """

    vertices: Floats
    tetrahedra: Integers
    fibres: Floats
    lv: Endocardium
    rv: Endocardium
    electrodes: Floats
    name: str = "heart"
    additional_electrodes: Mapping[str, Floats] = field(default_factory=dict)
    regions: Integers | None = None
    sheets: Floats | None = None
    torso: Torso | None = None
    lead_fields: LeadFields | None = None
    values: Mapping[str, float] = field(default_factory=dict)
    action_potential: TabulatedPotential | None = None
    coordinates: VentricularCoordinates | None = None
    example: Mapping[str, float] = field(default_factory=dict)
    atlas: Atlas | None = None
    folder: Path | None = None

    __repr__ = short_repr
    _repr_html_ = html_card

    def plot(self, view: str = "anterior", ax: Any = None) -> list[Any]:
        """Draw the heart by `fascicle.plot.heart`; returns Matplotlib axes."""
        return list(above("plot").heart(self, view, ax))

    def to_pyvista(self) -> Any:
        """`pyvista.UnstructuredGrid` (mm) with every array of the heart."""
        return pyvista_grid(*above("heart.folder").heart_mesh(self))

    def save(self, folder: Path | str) -> None:
        """Write the heart's folder, whole or not at all; `fascicle.load_heart` reads it."""
        above("heart.folder").write_heart(self, as_path(folder, "folder"))

    @property
    def has_torso(self) -> bool:
        """True if the heart lies in a torso, or has the lead fields of one."""
        return self.torso is not None or self.lead_fields is not None

    @property
    def endocardia(self) -> tuple[Endocardium, Endocardium]:
        """Left, then right endocardium."""
        return self.lv, self.rv

    @property
    def electrode_names(self) -> tuple[str, ...]:
        """The nine electrodes, then the additional ones."""
        return (*ELECTRODES, *self.additional_electrodes)

    @property
    def electrode_positions(self) -> Floats:
        """Positions (9 + a, 3) of `electrode_names` (mm)."""
        return np.array([*self.electrodes, *self.additional_electrodes.values()])

    @property
    def leads(self) -> tuple[str, ...]:
        """The twelve leads, then those of the additional electrodes."""
        return (*LEADS, *additional_leads([*self.additional_electrodes]))

    @cached_property
    def volumes(self) -> Floats:
        """Volume of each tetrahedron (mm³), shape (m,)."""
        return signed_volumes(self.vertices, self.tetrahedra)

    @cached_property
    def boundary(self) -> tuple[Integers, Integers]:
        """Boundary triangles (b, 3), counter-clockwise seen from outside, and their tetrahedra."""
        return boundary_triangles(self.tetrahedra)

    @cached_property
    def edges(self) -> Integers:
        """The vertices at the ends of each edge, shape (e, 2)."""
        return np.asarray(igl.edges(self.tetrahedra), dtype=np.int64)

    @property
    def no_image(self) -> str:
        """Statement that the heart is not from an image of the person; empty if it may be."""
        if self.atlas is None:
            return ""
        person = ", weighted for this person" if self.atlas.person else ""
        return f"no image: averaged over {len(self.atlas)} hearts of the population{person}"

    @cached_property
    def edge_length(self) -> float:
        """Mean edge length (mm)."""
        return float(edge_lengths(self.vertices, self.edges).mean())

    @cached_property
    def digest(self) -> str:
        """SHA-256 of everything that the forward model depends on."""
        arrays: list[NDArray[Any] | None] = [
            self.vertices, self.tetrahedra, self.fibres, self.electrodes,
        ]  # fmt: skip
        if self.additional_electrodes:
            arrays += [self.electrode_positions, np.array(self.electrode_names)]
        for e in self.endocardia:
            arrays += [e.vertices, e.triangles, np.array([e.root, e.direction]), e.valves, e.bare]
        arrays.append(self.regions)
        if self.lead_fields is not None:
            arrays.append(self.lead_fields.values)
        if self.torso is not None:
            arrays += [self.torso.vertices, self.torso.tetrahedra, self.torso.tissues]
        if self.values:
            arrays.append(np.array([repr(sorted(self.values.items()))]))
        if self.action_potential is not None:
            arrays += [self.action_potential.times, self.action_potential.potentials]
        if self.atlas is not None:  # its weights are a prior
            for part in (self.atlas.shapes, self.atlas.fields):
                arrays += [part.mean, part.components, part.coefficients]
            arrays += [self.atlas.electrodes, self.atlas.seeds, self.atlas.network_heights]
            arrays.append(np.array([repr(self.atlas.tissues)]))
        return digest_of(*(array for array in arrays if array is not None))


def digest_of(*arrays: NDArray[np.generic]) -> str:
    """SHA-256 of arrays: their shapes and contents, in this order."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
