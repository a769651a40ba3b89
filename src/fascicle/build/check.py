"""Measurements of a heart, with warnings where they are implausible."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import igl
import numpy as np

from fascicle.build.endocardia import cleaned_labels
from fascicle.build.surface_checks import Walls, median_thickness, wall_thickness
from fascicle.core.arrays import Floats
from fascicle.heart.conduction import Conduction
from fascicle.heart.endocardium import Endocardium, about_long_axis, long_axis
from fascicle.heart.fibres import placeholder
from fascicle.heart.heart import Heart, TorsoTissue
from fascicle.heart.labelled_surface import Label, LabelledMesh, labelled_mesh
from fascicle.mesh.measures import (
    Quality,
    closed_by_fan,
    edge_lengths,
    quality,
    signed_volumes,
    unit,
)
from fascicle.purkinje.chart import Chart, stretch
from fascicle.torso.electrode_sites import electrode_warnings
from fascicle.torso.lead_fields import is_up_to_date

WALLS = ("LV free wall", "septum", "RV free wall")


@dataclass(frozen=True)
class HelixAngles:
    """Fibre angles through one wall, at tetrahedra (k,).

    The depth is 0 at the endocardium (in the septum: the left one), 1 at the other side; the angle
    is to the circumference, within the wall (degrees, above -90, up to 90).
    """

    depth: Floats
    angle: Floats

    def in_layers(self) -> Floats:
        """Mean axis of the angles in each of five layers (degrees); NaN without fibres."""
        count = 5
        layer = np.minimum((self.depth * count).astype(int), count - 1)
        # fibres have no sign: angles are averaged on the doubled circle
        doubled = np.exp(2j * np.radians(self.angle))
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.array([doubled[layer == k].sum() for k in range(count)])
            mean = np.where(mean == 0, np.nan, mean)
        return np.asarray(np.degrees(np.angle(mean)) / 2)


@dataclass(frozen=True)
class HeartCheck:
    """Measurements of a heart; the boundary of the mesh is labelled."""

    # ratio of a chart's stretches in two directions, above which a check warns
    largest_stretch: ClassVar[float] = 12.0

    mesh: LabelledMesh
    rows: tuple[tuple[str, str], ...]  # quantity, and its value with the unit
    warnings: tuple[str, ...]  # one line each, with a remedy
    walls: Walls
    helix: Mapping[str, HelixAngles]  # helix angles by wall


def check_heart(heart: Heart, charts: Mapping[str, Chart]) -> HeartCheck:
    """Measure a valid heart with its charts (by side), and warn where something looks wrong."""
    mesh = labelled_mesh(heart)
    mesh = replace(mesh, labels=cleaned_labels(mesh.vertices, mesh.triangles, mesh.labels))
    walls = wall_thickness(mesh)
    shape = quality(heart.vertices, heart.tetrahedra)
    helix = helix_angles(mesh, heart)
    lv, rv = (cavity_volume(endocardium) for endocardium in heart.endocardia)
    muscle, extent = heart.volumes.sum() / 1e3, np.ptp(heart.vertices, axis=0)
    rows = [
        ("myocardium", f"{muscle:.1f} ml; cavities LV {lv:.0f}, RV {rv:.0f} ml"),
        ("extent", " x ".join(f"{size:.0f}" for size in extent) + " mm"),
        ("mesh", str(shape)),
    ]
    for name, wall in zip(WALLS, walls, strict=True):
        if wall.size:
            low, high = np.percentile(wall, [5, 95])
            rows.append((name, f"{np.median(wall):.1f} mm thick ({low:.1f} to {high:.1f})"))
    rows += _endocardium_rows(heart, charts)
    for name, angles in helix.items():
        if angles.depth.size:
            layers = ", ".join("-" if np.isnan(a) else f"{a:.0f}" for a in angles.in_layers())
            rows.append((f"helix, {name}", f"{layers} degrees, inside to outside"))
    rows += _torso_rows(heart)
    warnings = *_warnings(heart, walls, shape, charts, helix[WALLS[0]]), *_coarse_walls(mesh, walls)
    return HeartCheck(mesh, tuple(rows), warnings, walls, helix)


def cavity_volume(endocardium: Endocardium) -> float:
    """Volume of a cavity closed at its opening by a fan (ml)."""
    return -closed_by_fan(endocardium.vertices, endocardium.triangles)[0] / 1e3


def helix_angles(mesh: LabelledMesh, heart: Heart) -> dict[str, HelixAngles]:
    """Angles of the fibres through the three walls, by distances alone.

    A tetrahedron belongs to the wall between the two nearest of LV endocardium, RV endocardium and
    epicardium. Its depth is its fractional distance between them; the transmural direction is from
    the nearest point of the inner to that of the outer surface. As no Laplace problem is solved,
    the angles are an independent check of rule-based fibres.
    """
    some = slice(None, None, 1 + len(heart.tetrahedra) // 20_000)  # a sample suffices
    centres, fibres = heart.vertices[heart.tetrahedra[some]].mean(axis=1), heart.fibres[some]
    distances, nearest = np.full((3, len(centres)), np.inf), np.zeros((3, len(centres), 3))
    for k, label in enumerate((Label.LV_ENDOCARDIUM, Label.EPICARDIUM, Label.RV_ENDOCARDIUM)):
        if len(triangles := mesh.having(label)):
            square, _, point = igl.point_mesh_squared_distance(centres, mesh.vertices, triangles)
            distances[k], nearest[k] = np.sqrt(np.asarray(square)), point
    furthest = distances.argmax(axis=0)
    base, apex = long_axis(heart.lv.vertices, heart.lv.triangles)
    helix = {}
    for name, inner, outer in zip(WALLS, (0, 0, 2), (1, 2, 1), strict=True):
        outward = nearest[outer] - nearest[inner]
        across = distances[inner] + distances[outer]
        between = (furthest != inner) & (furthest != outer) & outward.any(axis=1)
        between &= np.isfinite(across)  # a missing surface is infinitely far
        rows = np.flatnonzero(between)  # where surfaces meet, no direction is transmural
        depth = distances[inner, rows] / across[rows]
        through = unit(outward[rows])
        along = unit(base - apex - (through @ (base - apex))[:, None] * through)
        upwards = np.einsum("ij,ij->i", fibres[rows], along)
        around = np.einsum("ij,ij->i", fibres[rows], np.cross(along, through))
        helix[name] = HelixAngles(depth, 90 - (90 - np.degrees(np.arctan2(upwards, around))) % 180)
    return helix


def _endocardium_rows(heart: Heart, charts: Mapping[str, Chart]) -> list[tuple[str, str]]:
    rows = []
    left = long_axis(heart.lv.vertices, heart.lv.triangles)
    for e in heart.endocardia:
        side, worst = e.side.upper(), _largest_stretch(e, charts[e.side])
        fine = HeartCheck.largest_stretch
        down, _, _ = about_long_axis(e.vertices, e.triangles, e.vertices, left)
        rows += [
            (f"{side} endocardium", f"{len(e.vertices)} points, {e.area / 100:.0f} cm²"),
            (
                f"{side} bundle",
                f"starts at point {e.root}, {down[e.root]:.0%} of the way from base to apex, and "
                f"heads for point {e.direction}, at {down[e.direction]:.0%}",
            ),
            (
                f"{side} map",
                "the endocardium laid flat for the Purkinje network, stretched up to "
                f"{worst:.1f} times more one way than the other (fine up to {fine:g})",
            ),
        ]
    return rows


def _largest_stretch(endocardium: Endocardium, chart: Chart) -> float:
    """Largest ratio of a chart's stretches, valve openings apart, where no network grows."""
    stretched = stretch(chart.metric)
    if endocardium.valves is not None:
        openings = endocardium.triangles[endocardium.valves]
        stretched = stretched[~np.isin(chart.triangles, openings).any(axis=1)]
    return float(stretched.max())


def _torso_rows(heart: Heart) -> list[tuple[str, str]]:
    some = heart.vertices[:: max(1, len(heart.vertices) // 2000)]
    distance = np.linalg.norm(heart.electrode_positions[:, None] - some, axis=2).min(axis=1)
    near = int(np.argmin(distance))
    names = heart.electrode_names
    value = f"{len(names)}; nearest to the heart {names[near]}, {distance[near]:.0f} mm"
    rows = [("electrodes", value)]
    if heart.torso is None:
        conductor = "lead fields given" if heart.lead_fields is not None else "unbounded conductor"
        return [*rows, ("torso", f"none ({conductor})")]
    volumes = signed_volumes(heart.torso.vertices, heart.torso.tetrahedra)
    parts = ", ".join(
        f"{tissue.name.lower()} {volumes[heart.torso.tissues == tissue].sum() / 1e6:.2f} l"
        for tissue in TorsoTissue
        if (heart.torso.tissues == tissue).any()
    )
    return [*rows, ("torso", f"{parts}; {len(heart.torso.vertices)} points")]


def _coarse_walls(mesh: LabelledMesh, walls: Walls) -> Iterator[str]:
    """Warnings of walls that are mostly thinner (median) than the edges at their endocardium."""
    edges = np.asarray(igl.edges(mesh.tetrahedra))
    lined = Label.LV_ENDOCARDIUM, Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM
    for name, wall, label in zip(WALLS, walls, lined, strict=True):
        near = np.isin(edges, mesh.having(label)).any(axis=1)
        length = edge_lengths(mesh.vertices, edges[near]).mean() if near.any() else 0.0
        if median_thickness(wall) < length:
            yield (
                f"mesh: edges of {length:.1f} mm are longer than the {name} is thick in "
                f"{(wall < length).mean():.0%} of it: fewer than two elements across; ECGs "
                "may be 6 to 9 % off: halve the edges (fascicle heart refine)"
            )


def _warnings(
    heart: Heart, walls: Walls, shape: Quality, charts: Mapping[str, Chart], free_wall: HelixAngles
) -> Iterator[str]:
    """Warnings about sizes, flat elements, charts, fibres, lead fields and electrodes."""
    lv, rv = (cavity_volume(endocardium) for endocardium in heart.endocardia)
    lv_wall, rv_wall = median_thickness(walls.lv), median_thickness(walls.rv)
    # ranges of human adults, healthy or not
    for part, value, (low, high), units, remedy in (
        ("LV cavity", lv, (40.0, 400.0), "ml", "check units and endocardium"),
        ("RV cavity", rv, (40.0, 400.0), "ml", "check units and endocardium"),
        ("myocardium", heart.volumes.sum() / 1e3, (60.0, 450.0), "ml", "check units and surfaces"),
        ("LV free wall", lv_wall, (4.0, 25.0), "mm", "check the labels of the surfaces"),
        ("RV free wall", rv_wall, (1.5, 12.0), "mm", "check the labels of the surfaces"),
    ):
        if np.isfinite(value) and not low <= value <= high:
            yield f"{part}: {value:.3g} {units}; human adults have {low:g} to {high:g}; {remedy}"
    if shape.angles.min() < 5.0:
        yield (
            f"mesh: smallest dihedral angle {shape.angles.min():.1f} degrees; remesh (heart "
            "build --remesh): times and potentials are poor in elements so flat"
        )
    for e in heart.endocardia:
        if (worst := _largest_stretch(e, charts[e.side])) > HeartCheck.largest_stretch:
            yield (
                f"{e.side.upper()} endocardium: the chart stretches {worst:.0f} times more one way "
                "than the other; branch angles are distorted there: remesh or smooth the surface"
            )
    inside, *_, outside = free_wall.in_layers()
    if fault := placeholder(heart.fibres):
        yield (
            f"fibres: they are a placeholder, as {fault}; build or import the heart again with "
            "--fibres rule"
        )
    elif inside + 20.0 < outside:  # false where a layer has no fibres (NaN)
        yield (
            f"fibres: the helix angle of the LV free wall goes from {inside:.0f} degrees inside to "
            f"{outside:.0f} outside; in human hearts it falls, from about 60 to -60: check that "
            "neither heart nor fibres are mirrored"
        )
    if heart.lead_fields is not None and not is_up_to_date(heart, Conduction()):
        consequence = "they are solved again when needed"
        if heart.torso is None:
            consequence = (
                "without a torso to compute new ones in, it cannot be simulated: build it again"
            )
        unusable = "its lead fields are not for these electrodes and fibres"
        yield f"{heart.name}: {unusable}; {consequence}"
    yield from electrode_warnings(heart)
