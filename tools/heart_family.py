"""Family of biventricular hearts: smooth deformations of one mesh to given volumes.

A heart of the family is the template moved along three displacement fields, then stretched along
and across its long axis. Each field moves one surface along its normals, leaves others where they
are, and is harmonic between them:

- the left endocardium inwards, with the epicardium and the right side of the septum at rest, which
  makes the left walls thicker;
- the free wall of the right ventricle outwards, as a whole, which makes its cavity larger;
- the epicardium of the right ventricle outwards, which makes its wall thicker.

All hearts of the family have the topology of the template, so that a vertex is the same place in
each of them, and ventricular coordinates need not be computed again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import igl
import numpy as np
from scipy.spatial import cKDTree

from fascicle.atlas.population import AtlasHeart, HeartSize
from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.atlas import endocardial_vertices
from fascicle.heart.coordinates import ventricular_coordinates
from fascicle.heart.fibres import Wall, rule_based_fibres
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import Label, LabelledMesh, labelled_mesh
from fascicle.mesh.measures import closed_by_fan, signed_volumes, solid_centroid, unit
from fascicle.torso.conductor import mesh_torso
from fascicle.torso.heart_pose import (
    TorsoFrame,
    default_position,
    endocardial_surfaces,
    heart_axes,
    opening,
    standard_axes,
)
from fascicle.torso.idealised import idealised_torso
from fascicle.torso.surfaces import Surface

DENSITY = 1.05  # g/ml of myocardium
LV_WALL, RV_WALL = 6.0, 3.0  # thickness (mm) of the template's free walls
# Distance (mm) within which bundles may start from where the template's do. The bundle branches
# differ greatly from person to person (Massing and James, Circulation 53:609, 1976); in a published
# heart the right one starts 41° in front of the middle, where the rule gives 7° (docs/hearts.md).
REACH = 14.0


@dataclass(frozen=True)
class HeartFamily:
    """Template, and what is needed to deform it.

    Attributes
    ----------
    template : Heart
        The template, with ventricular coordinates.
    mesh : LabelledMesh
        The template's mesh with its labelled boundary.
    taper : (n,) array
        1 in the middle of the right free wall, 0 at its attachments, at the apex and elsewhere.
    axes : (3, 3) array
        Axes of the template, columns, as `fascicle.torso.heart_pose.heart_axes` gives them.
    left : (m,) array
        Whether a tetrahedron belongs to the left ventricle or the septum.
    endocardial : pair of arrays
        Vertices of the mesh that are those of the left and the right endocardium.
    """

    template: Heart
    mesh: LabelledMesh
    taper: Floats
    axes: Floats
    left: Booleans
    endocardial: tuple[Integers, Integers]
    step: ClassVar[float] = 1.5  # mm that a surface is moved at once, at most

    @classmethod
    def of(cls, template: Heart) -> HeartFamily:
        """Family of a template, whose endocardia consist of vertices of its mesh."""
        mesh, coordinates = labelled_mesh(template), ventricular_coordinates(template)
        rotational, apicobasal = coordinates.rotational, coordinates.apicobasal
        free_wall = np.sin(np.pi * np.clip(1.5 * rotational, 0, 1))
        taper = free_wall * np.clip(apicobasal / 0.3, 0, 1) * (coordinates.ventricle == 1)
        lv, rv = endocardial_vertices(template)
        return cls(
            replace(template, coordinates=coordinates), mesh, taper,
            heart_axes(*endocardial_surfaces(mesh)), rule_based_fibres(mesh).wall != Wall.RV,
            (lv, rv),
        )  # fmt: skip

    def deformed(self, size: HeartSize) -> Heart:
        """Heart of the family, without electrodes (NaN), torso and lead fields; fibres are by rule.

        Raises
        ------
        InputError
            If no deformation gives these volumes.
        """
        tetrahedra = self.template.tetrahedra
        vertices = self._stretched(self.template.vertices, size.elongation)
        wanted = np.log([size.lv_volume, size.lv_mass, size.rv_volume])
        thickening = RV_WALL * (size.rv_wall - 1)  # mm that are left to do
        for _ in range(40):
            off = wanted - np.log(self.volumes(vertices))
            if np.abs(off).max() < 1e-3 and abs(thickening) < 1e-3:
                break
            fields = self._fields(vertices)
            # changes of the logarithms by a scale, and by 1 mm of the first two fields
            slopes = [np.full(3, 3.0)] + [
                (np.log(self.volumes(vertices + h)) - np.log(self.volumes(vertices - h))) / 2
                for h in fields[:2]
            ]
            log_scale, inwards, dilation = np.linalg.solve(np.transpose(slopes), off)
            moves = np.array([inwards, dilation, thickening])
            damping = min(1.0, self.step / np.abs(moves).max(), 0.05 / max(abs(log_scale), 1e-9))
            vertices = vertices + np.tensordot(damping * moves, fields, 1)
            thickening -= damping * thickening
            centre = vertices.mean(axis=0)
            vertices = centre + np.exp(damping * log_scale) * (vertices - centre)
            if signed_volumes(vertices, tetrahedra).min() <= 0:
                break
        else:
            off = wanted - np.log(self.volumes(vertices))
        if np.abs(off).max() > 0.01 or signed_volumes(vertices, tetrahedra).min() <= 0:
            raise InputError(
                f"atlas: no heart of the family has {size}; choose less extreme volumes"
            )
        fibres = rule_based_fibres(replace(self.mesh, vertices=vertices))
        lv, rv = (
            replace(e, vertices=vertices[numbers])
            for e, numbers in zip(self.template.endocardia, self.endocardial, strict=True)
        )
        return replace(
            self.template, vertices=vertices, fibres=fibres.fibre, sheets=fibres.sheet, lv=lv,
            rv=rv, electrodes=np.full_like(self.template.electrodes, np.nan), torso=None,
            lead_fields=None, folder=None,
        )  # fmt: skip

    def _fields(self, vertices: Floats) -> Floats:
        """Displacements (3, n, 3) that thicken the left walls, dilate and thicken the right one."""
        mesh = replace(self.mesh, vertices=vertices)
        lv, rv, epicardium = (
            np.unique(mesh.having(label))
            for label in (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM, Label.EPICARDIUM)
        )
        of_free_wall = self.taper[epicardium] > 0
        right, left = epicardium[of_free_wall], epicardium[~of_free_wall]
        # Surfaces move away from the left ventricle's long axis, the apical cap from its centre: a
        # smooth field, unlike that of the normals, turns no flat tetrahedron over.
        base, axis = opening(Surface(*mesh.part(Label.LV_ENDOCARDIUM))), self.axes[:, 2]
        level = (vertices - base) @ axis
        centre = base + np.maximum(level, 0.6 * level[lv].min())[:, None] * axis
        from_axis = unit(vertices - centre)
        outwards = self.taper[:, None] * from_axis
        # less where the left wall is thin, as the septum is at the base
        outside = np.union1d(epicardium, rv)
        thickness = cKDTree(vertices[outside]).query(vertices)[0][:, None]
        inwards = -from_axis * np.minimum(1.0, thickness / LV_WALL)
        return np.array(
            [
                _harmonic(mesh, lv, inwards, np.setdiff1d(outside, lv)),
                _harmonic(mesh, rv, outwards, np.union1d(left, lv)),
                _harmonic(mesh, right, outwards, np.union1d(np.union1d(left, lv), rv)),
            ]
        )

    def volumes(self, vertices: Floats) -> Floats:
        """Left cavity (ml), left mass (g) and right cavity (ml) of a deformed template."""
        lv, rv = (
            -closed_by_fan(vertices[numbers], e.triangles)[0] / 1e3
            for e, numbers in zip(self.template.endocardia, self.endocardial, strict=True)
        )
        tissue = signed_volumes(vertices, self.template.tetrahedra)[self.left].sum() / 1e3
        return np.array([lv, DENSITY * tissue, rv])

    def _stretched(self, vertices: Floats, elongation: float) -> Floats:
        """Vertices stretched along the long axis and shrunk across it, at equal volume."""
        factors = [elongation ** (-1 / 3), elongation ** (-1 / 3), elongation ** (2 / 3)]
        centre = vertices.mean(axis=0)
        return np.asarray(centre + (vertices - centre) @ (self.axes * factors) @ self.axes.T)


def with_drawn_seeds(heart: Heart, rng: np.random.Generator) -> Heart:
    """Heart whose bundles start at, and head for, random vertices of the endocardia.

    They are within `REACH` of those of the heart.
    """
    drawn = []
    for e in heart.endocardia:
        places = e.vertices[[e.root, e.direction]]
        distance = np.linalg.norm(e.vertices - places[:, None], axis=2)
        root, direction = (int(rng.choice(np.flatnonzero(d <= REACH))) for d in distance)
        drawn.append(replace(e, root=root, direction=direction))
    return replace(heart, lv=drawn[0], rv=drawn[1])


def _harmonic(
    mesh: LabelledMesh, moved: Integers, displacements: Floats, at_rest: Integers
) -> Floats:
    """Displacements (n, 3) that are harmonic between moved vertices and those at rest."""
    at_rest = np.setdiff1d(at_rest, moved)
    fixed = np.concatenate([moved, at_rest])
    values = np.concatenate([displacements[moved], np.zeros((len(at_rest), 3))])
    return np.asarray(igl.harmonic(mesh.vertices, mesh.tetrahedra, fixed, values, 1))


def heart_in_torso(family: HeartFamily, described: AtlasHeart, name: str = "atlas") -> Heart:
    """Heart of a family in its torso, with electrodes and without lead fields.

    Raises
    ------
    InputError
        If no deformation gives the heart's volumes, or it does not fit into the torso.
    """
    heart, size = family.deformed(described.size), described.trunk_size
    mesh = replace(family.mesh, vertices=heart.vertices, name=name)
    rotation = family.axes @ standard_axes(*described.axis).T
    centroid = solid_centroid(heart.vertices, heart.tetrahedra)
    position = default_position(size) + described.shift
    frame = TorsoFrame(rotation, centroid - rotation @ position)
    surfaces = idealised_torso(mesh, size, frame)
    assert surfaces.electrodes is not None
    torso = mesh_torso(mesh, surfaces.skin, surfaces.lungs)
    return replace(heart, name=name, electrodes=surfaces.electrodes, torso=torso)
