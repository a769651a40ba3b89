"""Ventricular coordinates: error of the mesh, maps there and back, and the documentation's figure.

    python -m benchmarks.ventricular_coordinates [HEART ...] [--figure FILE]

The packaged heart is compared with itself on a mesh of half the edge length, and positions are
carried to the other hearts and back. The figure draws those of the packaged subject's heart.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import igl
import numpy as np

import fascicle
from fascicle.build.refinement import in_eight
from fascicle.heart.coordinates import computed_coordinates
from fascicle.heart.labelled_surface import labelled_mesh
from fascicle.mesh.topology import boundary_triangles


def error_of_the_mesh(heart):
    mesh = labelled_mesh(heart)
    finer = in_eight(mesh.vertices, mesh.tetrahedra)
    triangles, _ = boundary_triangles(finer.tetrahedra)
    middle = finer.vertices[triangles].mean(axis=1)
    parent = igl.point_mesh_squared_distance(middle, mesh.vertices, mesh.triangles)[1]
    fine = computed_coordinates(
        replace(
            mesh,
            vertices=finer.vertices,
            tetrahedra=finer.tetrahedra,
            triangles=triangles,
            labels=mesh.labels[parent],
            regions=None,
        )
    )
    coarse = fascicle.ventricular_coordinates(heart)
    print(f"{heart.name}: mean edge {heart.edge_length:.1f} mm, against half of it")
    for name, values in coarse.arrays.items():
        off = np.abs(fine.arrays[name][: len(values)] - values)
        off = np.minimum(off, 1 - off) if name == "rt" else off
        off = off[coarse.apicobasal > 0.1] if name == "rt" else off
        print(f"  {name}: root mean square {np.sqrt((off**2).mean()):.3f}, largest {off.max():.2f}")


def there_and_back(heart, other):
    mapped = fascicle.transfer_map(heart.vertices.T, heart, other)
    back = fascicle.transfer_map(mapped, other, heart).T
    off = np.linalg.norm(back - heart.vertices, axis=1)
    print(f"{heart.name} to {other.name} and back: median {np.median(off):.2f} mm", end=", ")
    print(f"95 of 100 vertices within {np.quantile(off, 0.95):.2f} mm")


def draw(heart, file):
    import pyvista as pv

    coordinates = fascicle.ventricular_coordinates(heart)
    grid = pv.UnstructuredGrid({10: heart.tetrahedra}, heart.vertices)
    grid.point_data.update(coordinates.arrays)
    middle = heart.vertices.mean(axis=0)
    septal = (coordinates.rotational > 0.8) & (coordinates.rotational < 0.87)
    right = heart.vertices[septal].mean(axis=0) - heart.lv.vertices.mean(axis=0)
    up = heart.vertices[coordinates.apicobasal == 1].mean(axis=0) - middle
    up /= np.linalg.norm(up)
    front = np.cross(up, right)  # anterior to the reader
    front /= np.linalg.norm(front)
    plot = pv.Plotter(shape=(2, 4), off_screen=True, window_size=(1600, 820), border=False)
    for column, name in enumerate(coordinates.arrays):
        colours = {"scalars": name, "cmap": "hsv" if name == "rt" else "viridis", "clim": (0, 1)}
        bar = {"title": name, "n_labels": 3, "title_font_size": 20, "color": "black"}
        for row in (0, 1):
            plot.subplot(row, column)
            part = (
                grid.slice(normal=up, origin=middle)
                if row == 0
                else grid.clip(front, origin=middle)
            )
            away = -up if row == 0 else front
            bar = {**bar, "fmt": "%.1f"}
            plot.add_mesh(part, **colours, scalar_bar_args=bar, show_scalar_bar=row == 1)
            plot.camera_position = [middle + 310 * away, middle, front if row == 0 else up]
    plot.set_background("white")
    plot.screenshot(file)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("hearts", nargs="*")
    parser.add_argument("--figure")
    arguments = parser.parse_args()
    packaged = fascicle.load_heart("default")
    if arguments.figure:
        draw(fascicle.load_heart("camps-dti004"), arguments.figure)
    else:
        error_of_the_mesh(packaged)
        for folder in arguments.hearts:
            there_and_back(packaged, fascicle.load_heart(folder))
