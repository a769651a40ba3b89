"""Conductivities of the tissues, and conduction velocities that follow from the myocardium's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar

import igl
import numpy as np

from fascicle.core.arrays import Booleans, Floats
from fascicle.core.declared import Conductivity, Label, Point, Radius, Table
from fascicle.core.errors import InputError
from fascicle.core.quantities import checked, default_of, quantity, region_labels
from fascicle.core.ranges import check_items, within
from fascicle.heart.heart import Heart


class Region(Table, table="region"):
    """Part of the myocardium that conducts differently: give a label, or centre and radius."""

    conductivity: Annotated[
        Conductivity, "factor on all conductivities, so that speeds change by its root; 0 is scar"
    ]
    label: Annotated[Label | None, "the elements with this number in `region`"] = None
    centre: Annotated[Point | None, "centre of a sphere"] = None
    radius: Annotated[Radius | None, "the elements whose centroid lies within it"] = None
    source: str | None = field(default=None, repr=False, compare=False)

    def elements(self, heart: Heart) -> Booleans:
        """Return whether each tetrahedron belongs to the region, shape (m,).

        Raises
        ------
        InputError
            If its place is missing or described twice, or it holds no element.
        """
        present = [value is not None for value in (self.label, self.centre, self.radius)]
        if present not in ([True, False, False], [False, True, True]):
            raise InputError(f"{self.name}: give either a label, or a centre and a radius")
        if self.label is not None:
            if heart.regions is None:
                raise InputError(
                    f"{self.name}: the heart has no labels; import it from a mesh with the cell "
                    "array 'region', or give a centre and a radius"
                )
            inside = heart.regions == self.label
            hint = f"the heart's labels are {', '.join(map(str, np.unique(heart.regions)))}"
        else:
            centroids = heart.vertices[heart.tetrahedra].mean(axis=1)
            distance = np.linalg.norm(centroids - np.asarray(self.centre), axis=1)
            inside = distance <= self.radius
            hint = f"the nearest is {distance.min():.1f} mm from its centre"
        if not inside.any():
            raise InputError(f"{self.name} holds no element; {hint}")
        return np.asarray(inside)

    @property
    def name(self) -> str:
        """Name of the region in messages."""
        origin = f"{self.source}: " if self.source is not None else ""
        return f"{origin}region {f'at {self.centre}' if self.label is None else self.label}"


@dataclass(frozen=True)
class Conduction:
    """Bidomain conductivities along (l) and across (t) the fibre, and the speed constant α.

    Attributes
    ----------
    intracellular_l, intracellular_t, extracellular_l, extracellular_t : float
        Conductivities (mS/cm).
    alpha : float
        α (cm·ms⁻¹·(mS/cm)^-½): D = α² Gᵢ(Gᵢ+Gₑ)⁻¹Gₑ; 0.05 to 0.1 in the paper's patients.
    torso : float
        Conductivity of the unbounded volume conductor (mS/cm), for hearts without a torso mesh;
        about that of the torso as a whole, lungs included. A torso mesh has the next three instead.
    body : float
        Conductivity of the tissue around the heart that is neither lung nor blood (mS/cm); 2.39 is
        that of the homogeneous torso of Klepfer, Johnson and MacLeod (IEEE Trans. Biomed. Eng. 44,
        1997, 706-719), the mean over its tissues.
    lung, blood : float
        Conductivities (mS/cm); 0.389 and 7.0 are those of inflated lung and of blood at 10 Hz in
        the parametric model of Gabriel, Lau and Gabriel (Phys. Med. Biol. 41, 1996, 2271-2293).
    regions : tuple of Region
        Parts of the myocardium that conduct differently; where they overlap the last one counts.
    anisotropy_ratio : float, optional
        Conduction velocity along the fibre over that across it; by default the conductivities'.
    endocardial_layer : float
        Thickness (mm) of a layer under the endocardia that conducts faster.
    endocardial_speed : float
        Factor on the conduction velocities in that layer; conductivities, and so the ECG of a given
        activation sequence, stay.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    # names of the fields that are conductivities, and of those that set the velocities alone
    conductivities: ClassVar = (
        "intracellular_l", "intracellular_t", "extracellular_l", "extracellular_t",
        "torso", "body", "lung", "blood",
    )  # fmt: skip
    velocities: ClassVar = ("alpha", "anisotropy_ratio", "endocardial_layer", "endocardial_speed")

    intracellular_l: float = 3.0
    intracellular_t: float = 0.3
    extracellular_l: float = 3.0
    extracellular_t: float = 1.2
    alpha: float = default_of("alpha")
    torso: float = 2.0
    body: float = 2.39
    lung: float = 0.389
    blood: float = 7.0
    regions: tuple[Region, ...] = ()
    anisotropy_ratio: float | None = None
    endocardial_layer: float = default_of("endocardial_layer")
    endocardial_speed: float = default_of("endocardial_speed")

    def __post_init__(self) -> None:
        for name in self.conductivities:
            within("conductivity", getattr(self, name), f"conductivity '{name}'")
        check_items(self.regions, Region, "regions", "fascicle.Region")
        parameters = {name: getattr(self, name) for name in self.velocities}
        if self.anisotropy_ratio is None:
            del parameters["anisotropy_ratio"]
        checked(parameters)

    @classmethod
    def of(cls, heart: Heart, regions: Sequence[Region] = ()) -> Conduction:
        """Conduction of a heart's stored values and of `regions`, which take precedence."""
        conduction = cls().with_values(heart.values)
        return replace(conduction, regions=(*conduction.regions, *regions))

    def with_values(self, values: Mapping[str, float]) -> Conduction:
        """Return a copy with other values, those of the `fascicle.core.quantities` that concern it.

        A region replaces an earlier one of the same label.
        """
        changes = {name: values[name] for name in self.velocities if name in values}
        if "fibre_speed" in values:
            changes["alpha"] = self.alpha * values["fibre_speed"] / self.speeds[0]
        labels = region_labels(values)
        regions = [r for r in self.regions if r.label is None or r.label not in labels]
        added = [Region(values[name], label) for label, name in labels.items()]
        changed = replace(self, regions=(*added, *regions), **changes)
        for name, value in values.items():
            if (apply := quantity(name).apply) is not None:
                changed = apply(changed, value)
        return changed

    def scale(self, heart: Heart) -> Floats:
        """Factor on all conductivities of each tetrahedron, shape (m,); 0 in scar."""
        scale = np.ones(len(heart.tetrahedra))
        for region in self.regions:
            scale[region.elements(heart)] = region.conductivity
        if not (scale > 0).any():
            raise InputError("no tissue conducts; make the regions of conductivity 0 smaller")
        return scale

    def diffusion_scale(self, heart: Heart) -> Floats:
        """Factor on D, the square of the speeds, of each tetrahedron, shape (m,)."""
        scale = self.scale(heart)
        if self.endocardial_layer > 0 and self.endocardial_speed != 1:
            distance = np.full(len(heart.vertices), np.inf)
            for e in heart.endocardia:
                nearest = igl.point_mesh_squared_distance(heart.vertices, e.vertices, e.triangles)
                distance = np.minimum(distance, np.sqrt(nearest[0]))
            share = share_below(distance[heart.tetrahedra], self.endocardial_layer)
            scale *= 1 + share * (self.endocardial_speed**2 - 1)
        return scale

    @property
    def speeds(self) -> tuple[float, float]:
        """Conduction velocity along and across the fibre (mm/ms)."""
        along, across = np.sqrt(self._squared_speeds())
        return float(along), float(across)

    def _squared_speeds(self) -> tuple[float, float]:
        """D along and across the fibre (mm²/ms²), scalars, as all G have the same axes."""
        intra = np.array([self.intracellular_l, self.intracellular_t])
        extra = np.array([self.extracellular_l, self.extracellular_t])
        # α² G is in (cm/ms)², 100 mm² a cm²
        along, across = 100.0 * self.alpha**2 * intra * extra / (intra + extra)
        if self.anisotropy_ratio is not None:
            across = along / self.anisotropy_ratio**2
        return along, across

    def intracellular(self, fibres: Floats) -> Floats:
        """Gᵢ (mS/cm) for unit fibres of shape (m, 3); shape (m, 3, 3)."""
        return transversely_isotropic(fibres, self.intracellular_l, self.intracellular_t)

    def bulk(self, fibres: Floats) -> Floats:
        """Gᵢ + Gₑ (mS/cm) for unit fibres of shape (m, 3); shape (m, 3, 3)."""
        along = self.intracellular_l + self.extracellular_l
        return transversely_isotropic(fibres, along, self.intracellular_t + self.extracellular_t)

    def metric(self, fibres: Floats) -> Floats:
        """D⁻¹ (ms²/mm²) for unit fibres of shape (m, 3); shape (m, 3, 3)."""
        along, across = self._squared_speeds()
        return transversely_isotropic(fibres, 1 / along, 1 / across)


def share_below(values: Floats, level: float) -> Floats:
    """Share of the volume in which a function, linear in a tetrahedron, is below a level, (m,).

    It is the distribution function of the quadratic B-spline whose knots are the four values at
    the corners (m, 4) (Hermite-Genocchi).
    """
    knots = np.sort(values, axis=1)
    # the formula divides by the gaps: equal knots are set apart by a millionth of their size
    apart = 1e-6 * np.maximum(np.abs(knots).max(axis=1, keepdims=True), 1e-12)
    knots = knots + apart * np.arange(4)
    gaps = knots[:, None, :] - knots[:, :, None]
    gaps[:, range(4), range(4)] = 1.0
    share = (np.clip(level - knots, 0, None) ** 3 / gaps.prod(axis=2)).sum(axis=1)
    share = np.where(level >= knots[:, 3], 1.0, np.where(level <= knots[:, 0], 0.0, share))
    return np.asarray(np.clip(share, 0.0, 1.0))


def transversely_isotropic(fibres: Floats, along: float, across: float) -> Floats:
    """Tensors `across`·I + (`along` − `across`)·f⊗f for unit fibres f (m, 3), (m, 3, 3)."""
    dyads = fibres[:, :, None] * fibres[:, None, :]
    return np.asarray(across * np.eye(3) + (along - across) * dyads)
