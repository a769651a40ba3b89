"""Content of a mesh file, whatever its format."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError

OPENCARP_FORMATS = (".pts", ".elem")  # either names both files, and the `.lon`
# VTK's numbers for the cells that are used here
VERTEX, LINE, TRIANGLE, QUADRANGLE, TETRAHEDRON = 1, 3, 5, 9, 10
# Cells that are cut into tetrahedra
SOLIDS = {11: "voxels", 12: "hexahedra", 13: "wedges", 14: "pyramids"}
# Number of corners; a quadratic cell has more points, which come after them
CELL_CORNERS = {LINE: 2, TRIANGLE: 3, QUADRANGLE: 4, TETRAHEDRON: 4, 11: 8, 12: 8, 13: 6, 14: 5}
GROUP = "gmsh:physical"  # meshio's name for the number of a cell's physical group


def damaged(path: Path, fault: object) -> InputError:
    """Error of a file that ends early or contradicts itself."""
    return InputError(f"{path}: truncated or damaged ({fault}); export or copy it again")


@dataclass(frozen=True)
class MeshFile:
    """Points and cells of a file, whatever its format.

    Points (n, 3) are in the file's unit. Cells are point indices (m, k) of each kind by VTK's
    number; arrays have one row a point, or a cell of a kind.
    """

    path: Path
    points: Floats
    cells: dict[int, Integers]
    point_data: dict[str, Floats] = field(default_factory=dict)
    cell_data: dict[int, dict[str, Floats]] = field(default_factory=dict)
    other_cells: dict[str, int] = field(default_factory=dict)  # number of those of other kinds
    has_polylines: bool = False  # a line was split into segments, which share its cell data
    # dimension and number of Gmsh's physical groups; cells have the number in the array `GROUP`
    groups: dict[str, tuple[int, int]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # how the cells were changed, for the user

    def cell_array(self, kind: int, name: str) -> Floats | None:
        """Values of an array on cells of one kind, if there is one of that name."""
        values = self.cell_data.get(kind, {}).get(name)
        return None if values is None else np.asarray(values, dtype=float)

    def keeping(self, kind: int, chosen: Booleans | Integers) -> MeshFile:
        """File with only some cells of one kind, chosen by mask or row, and their data."""
        arrays = {name: values[chosen] for name, values in self.cell_data.get(kind, {}).items()}
        return replace(
            self,
            cells={**self.cells, kind: self.cells[kind][chosen]},
            cell_data={**self.cell_data, kind: arrays},
        )

    def require(self, kind: int, name: str) -> Integers:
        """Cells of one kind; InputError if the file has none, or other solid or surface cells."""
        cells = self.cells.get(kind)
        other_cells = ", ".join(f"{count} {other}" for other, count in self.other_cells.items())
        if cells is None or not len(cells):
            contents = f"{len(self.points)} points, other cells: {other_cells or 'none'}"
            raise InputError(
                f"{self.path}: no {name} in this file ({contents}); give a mesh that has {name}"
            )
        if self.other_cells and kind != LINE:
            raise InputError(
                f"{self.path}: {len(cells)} {name}, but also other cells ({other_cells}); "
                f"make the whole mesh of {name}"
            )
        return cells
