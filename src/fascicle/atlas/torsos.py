"""Hearts of the atlas in their torsos."""

from __future__ import annotations

from dataclasses import replace

from fascicle.atlas.population import AtlasHeart
from fascicle.atlas.shapes import HeartFamily
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import solid_centroid
from fascicle.torso.conductor import mesh_torso
from fascicle.torso.heart_pose import TorsoFrame, default_position, standard_axes
from fascicle.torso.idealised import idealised_torso


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
