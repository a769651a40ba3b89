"""Triangles by Mmg, VTK and libigl, tetrahedra by Netgen: arrays in, arrays out."""

from __future__ import annotations

import os
import re
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from tempfile import TemporaryFile
from typing import IO, NamedTuple

import igl
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.mesh.measures import closed_volume, signed_volumes, turned_outwards
from fascicle.mesh.topology import unique_edges


class Interface(NamedTuple):
    """A closed surface (mm), counter-clockwise seen from outside, between two domains.

    Domains have numbers from 1 up without gaps; 0 is Netgen's number for one without elements.
    """

    vertices: Floats
    triangles: Integers
    inner: int = 1
    outer: int = 0


def tetrahedralise(
    interfaces: Sequence[Interface], space: str, remedy: str, **parameters: float
) -> tuple[Floats, Integers, Integers]:
    """Fill the domains between closed surfaces, left as they are, by Netgen.

    Schöberl 1997, Comput Vis Sci 1:41-52. The surfaces touch neither themselves nor one another.
    An error calls what lies between them `space`. Netgen's parameters are ``maxh``, the longest
    edge (mm), and others.

    The result is vertices (n, 3) (mm), those of the interfaces first, tetrahedra (m, 4), positively
    oriented, and the domain that each lies in (m,).
    """
    from netgen import meshing as netgen

    netgen.SetMessageImportance(0)
    mesh = netgen.Mesh()
    mesh.dim = 3
    count = 0
    for face, (vertices, triangles, inner, outer) in enumerate(interfaces, start=1):
        mesh.AddPoints(np.ascontiguousarray(vertices, dtype=np.float64))
        index = mesh.Add(netgen.FaceDescriptor(bc=face, domin=inner, domout=outer, surfnr=face))
        mesh.AddElements(dim=2, index=index, data=as_int32(triangles + count), base=0)
        count += len(vertices)
    # Netgen prints every intersection that it finds
    with signals_restored(), _kept_quiet() as printed:
        try:
            mesh.GenerateVolumeMesh(netgen.MeshingParameters(**parameters))
        except netgen.NgException as error:
            printed.write(f"failed with error: {error}\n".encode())
        printed.seek(0)
        log = printed.read().decode(errors="replace")
        failure = re.search(r"failed with error: (?:Stop meshing since )?(.+)", log)
    elements = mesh.Elements3D().NumPy()
    corners = elements["nodes"] if len(elements) else np.empty((0, 4))
    tetrahedra = corners[:, [0, 2, 1, 3]].astype(np.int64) - 1  # Netgen orients otherwise
    vertices = np.array(mesh.Coordinates(), dtype=float, order="C")
    missing = 1 - float(signed_volumes(vertices, tetrahedra).sum()) / sum(
        closed_volume(interface.vertices, interface.triangles)
        * (int(interface.inner > 0) - int(interface.outer > 0))
        for interface in interfaces
    )
    if abs(missing) > 1e-6:  # more than rounding: it leaves out what it cannot fill
        why = f" ({failure[1].strip()})" if failure else ""
        raise InputError(
            f"{space}: {missing:.2%} could not be filled with tetrahedra{why}; {remedy}"
        )
    return vertices, tetrahedra, elements["index"].astype(np.int64)


@contextmanager
def signals_restored() -> Iterator[None]:
    """Restore Python's signal handlers after Mmg, which removes them, so that Ctrl-C works.

    While it runs, a signal ends the process at once.
    """
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, signal.getsignal(number))


@contextmanager
def _kept_quiet() -> Iterator[IO[bytes]]:
    """Send what compiled code prints to a file."""
    with TemporaryFile() as printed:
        streams = [(stream, os.dup(stream)) for stream in (1, 2)]
        try:
            for stream, _ in streams:
                os.dup2(printed.fileno(), stream)
            yield printed
        finally:
            for stream, before in streams:
                os.dup2(before, stream)
                os.close(before)


def remeshed_triangles(
    vertices: Floats, triangles: Integers, labels: Integers, **options: float
) -> tuple[Floats, Integers, Integers]:
    """Triangulate a labelled surface (mm) again by Mmg, which keeps the borders between labels.

    Its options are ``hsiz``, ``hmin``, ``hmax`` and ``hausd`` (mm), ``angle`` (1: keep sharp
    edges). Dapogny, Dobrzynski and Frey 2014, J Comput Phys 262:358-378.
    """
    import mmgpy

    # triangles are set twice, as only the second call takes their labels
    mesh = mmgpy.MmgMeshS(np.ascontiguousarray(vertices, dtype=np.float64), as_int32(triangles))
    mesh.set_triangles(as_int32(triangles), as_int32(labels))
    with signals_restored():
        mesh.remesh(**options, verbose=-1)
    new, new_labels = mesh.get_triangles_with_refs()
    return (
        np.array(mesh.get_vertices(), dtype=float),
        np.array(new, dtype=np.int64),
        np.array(new_labels, dtype=np.int64),
    )


def remeshed_tetrahedra(
    vertices: Floats, tetrahedra: Integers, triangles: Integers, labels: Integers, **options: float
) -> tuple[Floats, Integers, Integers, Integers]:
    """Mesh the inside of a labelled boundary (b, 3) again by Mmg; the boundary stays.

    Its options are ``hsiz``, the edge length (mm), or ``optim=1``, which keeps it.
    """
    import mmgpy

    mesh = mmgpy.MmgMesh3D(np.ascontiguousarray(vertices, dtype=np.float64), as_int32(tetrahedra))
    mesh.set_mesh_size(vertices=len(vertices), tetrahedra=len(tetrahedra), triangles=len(triangles))
    mesh.set_vertices(np.ascontiguousarray(vertices, dtype=np.float64))
    mesh.set_tetrahedra(as_int32(tetrahedra))
    mesh.set_triangles(as_int32(triangles), as_int32(labels))
    with signals_restored():
        mesh.remesh(**options, nosurf=1, verbose=-1)
    kept, kept_labels = mesh.get_triangles_with_refs()
    return (
        np.array(mesh.get_vertices(), dtype=float),
        np.array(mesh.get_tetrahedra(), dtype=np.int64),
        np.array(kept, dtype=np.int64),
        np.array(kept_labels, dtype=np.int64),
    )


def constrained_delaunay(places: Floats, loops: Sequence[Integers]) -> tuple[Integers, Integers]:
    """Triangulate the region between closed lines in a plane by VTK; their sides are kept.

    `places` are points (n, 2); each loop (k,) holds the points along one line, the outermost first.
    The second result (s,) are the first points of sides that are not an edge of the triangles'
    boundary: if there are any, lines cross or touch, and the triangles (m, 3) are invalid.
    """
    import pyvista as pv

    points = np.column_stack([places, np.zeros(len(places))])
    faces: list[int] = []
    for k, loop in enumerate(loops):
        x, y = places[loop].T
        counter_clockwise = float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) > 0
        # VTK fills what lies to the left of a line
        faces += [len(loop), *(loop if counter_clockwise == (k == 0) else loop[::-1])]
    with pv.vtk_verbosity("off"):
        mesh = pv.PolyData(points).delaunay_2d(edge_source=pv.PolyData(points, faces=faces))
    triangles = np.asarray(mesh.regular_faces, dtype=np.int64)
    edges, shared = unique_edges(triangles)
    boundary = set(map(tuple, edges[shared == 1].tolist()))
    starts = np.concatenate(loops)
    sides = np.column_stack([starts, np.concatenate([np.roll(loop, -1) for loop in loops])])
    kept = np.array([tuple(side) in boundary for side in np.sort(sides, axis=1).tolist()])
    return triangles, starts if len(boundary) > len(sides) else starts[~kept]


def marching_cubes(values: Floats) -> tuple[Floats, Integers]:
    """Surface of {values < 0} on a grid, in node indices, with outward normals, by libigl."""
    corners = np.array(
        [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    )
    inside = sliding_window_view(values < 0, (2, 2, 2))
    cells = np.argwhere(inside.any(axis=(3, 4, 5)) & ~inside.all(axis=(3, 4, 5)))
    nodes = np.ravel_multi_index(tuple(np.moveaxis(cells[:, None] + corners, 2, 0)), values.shape)
    used, cubes = np.unique(nodes, return_inverse=True)
    positions = np.stack(np.unravel_index(used, values.shape), axis=1).astype(np.float64)
    vertices, triangles, _ = igl.marching_cubes(
        values.ravel()[used], positions, cubes.reshape(-1, 8).astype(np.int64), 0.0
    )
    return vertices, turned_outwards(vertices, triangles)


def as_int32(array: Integers) -> NDArray[np.int32]:
    """Array in the type and memory order that the meshers need; Mmg misreads any other."""
    return np.ascontiguousarray(array, dtype=np.int32)
