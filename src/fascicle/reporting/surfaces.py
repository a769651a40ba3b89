"""Surfaces rendered off screen by VTK, in orthographic views aligned with the heart."""

from __future__ import annotations

from collections.abc import Mapping
from ctypes.util import find_library
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from fascicle.core import DISTRIBUTION
from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.heart.endocardium import long_axis
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import unit


@dataclass(frozen=True)
class View:
    """An orthographic camera; its name stands above the picture."""

    name: str
    axes: Floats  # (3, 3), rows are unit vectors to the right, up and away from the eye
    centre: Floats  # (3,) mm, position of the origin of the screen

    def project(self, positions: Floats) -> Floats:
        """Screen coordinates and depth (mm; larger is farther), the shape of `positions`."""
        return np.asarray((positions - self.centre) @ self.axes.T)

    def box(self, positions: Floats) -> Floats:
        """Lower left and upper right corner (mm), (2, 2), of positions (n, 3) on the screen."""
        screen = self.project(positions)[:, :2]
        return np.array([screen.min(axis=0), screen.max(axis=0)])

    def facing(self, normals: Floats) -> Booleans:
        """Mask (k,) of the normals (k, 3) that point towards the eye."""
        return np.asarray(normals @ self.axes[2] < 0)


@dataclass(frozen=True)
class DrawnSurface:
    """Vertices (n, 3) (mm) and triangles (m, 3) to draw; `pyvista.Plotter.add_mesh` has the look.

    Only triangles that appear counter-clockwise are visible.
    """

    vertices: Floats
    triangles: Integers
    look: Mapping[str, Any]


def heart_views(heart: Heart) -> dict[str, View]:
    """Place cameras in the heart's intrinsic frame, whatever the frame of its coordinates.

    The long axis runs from the centre of the LV endocardium's opening to its farthest point. The
    patient's left is the direction from the right to the left cavity, perpendicular to that axis;
    the front follows. The base is up; the view of the base has the front below and the patient's
    left on the right.
    """
    base, apex = long_axis(heart.lv.vertices, heart.lv.triangles)
    towards_left = heart.lv.vertices.mean(axis=0) - heart.rv.vertices.mean(axis=0)
    (left, back, up), centre = upright_frame(base - apex, towards_left, heart.vertices)
    axes = {
        "RV side": (-back, up, left),
        "anterior": (left, up, back),
        "LV side": (back, up, -left),
        "base": (left, back, -up),
    }
    return {name: View(name, np.array(rows), centre) for name, rows in axes.items()}


def upright_frame(up: Floats, left: Floats, positions: Floats) -> tuple[Floats, Floats]:
    """Unit vectors to the left, the back and upwards, the rows of (3, 3), and a centre (3,) (mm).

    The centre is the middle of the box along these vectors that holds the positions (n, 3). `left`
    need not be perpendicular to `up`.
    """
    up = unit(up)
    left = unit(left - (left @ up) * up)
    frame = np.array([left, np.cross(up, left), up])
    along = positions @ frame.T
    return frame, (along.min(axis=0) + along.max(axis=0)) / 2 @ frame


def draw_surfaces(
    axes: Axes, view: View, *surfaces: DrawnSurface, box: Floats, size: Floats
) -> None:
    """Draw surfaces into axes, which then are in mm and have no frame.

    The axes show a width and height, `size` (2,) (mm), about the middle of `box` (2, 2), the lower
    left and the upper right corner of a rectangle on the screen (mm).
    """
    low, high = box.mean(axis=0) - size / 2, box.mean(axis=0) + size / 2
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_axis_off()
    axes.set_title(view.name)
    picture = _rendered(view, surfaces, (low + high) / 2, size)
    if picture is None:
        text = "not drawn: VTK finds\nneither EGL nor OSMesa"
        if find_spec("pyvista") is None:
            text = f"not drawn: needs pyvista;\npip install '{DISTRIBUTION}[build]'"
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center")
    else:
        axes.imshow(picture, extent=(low[0], high[0], low[1], high[1]))


def scale_bar(axes: Axes, length: float) -> None:
    """Draw a bar of a length (mm) below the lower left corner."""
    left, bottom = axes.get_xlim()[0], axes.get_ylim()[0]
    axes.plot([left, left + length], [bottom] * 2, color="black", linewidth=2, clip_on=False)
    axes.annotate(
        f"{length:g} mm", (left + length / 2, bottom), (0, -3), textcoords="offset points",
        ha="center", va="top", fontsize="small",
    )  # fmt: skip


def largest(boxes: list[Floats]) -> Floats:
    """Width and height (mm) of panels that hold the largest of the boxes, with a margin."""
    return np.asarray(1.04 * np.max([np.ptp(box, axis=0) for box in boxes], axis=0))


def _rendered(
    view: View, surfaces: tuple[DrawnSurface, ...], middle: Floats, size: Floats
) -> Floats | None:
    """Picture of an area of the screen (mm); None where nothing can be rendered."""
    plotter = _plotter() if find_spec("pyvista") else None
    if plotter is None:
        return None
    from pyvista import make_tri_mesh

    plotter.suppress_rendering = True  # once, when all is in place
    plotter.clear_actors()
    plotter.window_size = np.round(600 * size / size.max()).astype(int).tolist()
    for surface in surfaces:
        mesh = make_tri_mesh(surface.vertices, surface.triangles)
        plotter.add_mesh(
            mesh, ambient=0.65, diffuse=0.35, smooth_shading=True, split_sharp_edges=True,
            feature_angle=35, culling="back", show_scalar_bar=False, reset_camera=False,
            render=False, **surface.look,
        )  # fmt: skip
    right, up, away = view.axes
    focus = view.centre + middle @ np.array([right, up])
    reach = 2 * max(float(np.abs(s.vertices - focus).max(initial=1.0)) for s in surfaces)
    camera = plotter.camera
    camera.focal_point, camera.position, camera.up = focus, focus - reach * away, up
    camera.parallel_projection, camera.parallel_scale = True, size[1] / 2
    camera.clipping_range = (0.01 * reach, 2 * reach)
    plotter.suppress_rendering = False
    plotter.render()
    return np.asarray(plotter.screenshot(return_img=True))


@cache
def _plotter() -> Any:
    """Shared plotter of this process; None where VTK cannot render and would crash."""
    import pyvista
    from vtkmodules.vtkCommonCore import vtkLogger

    before = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)  # VTK reports every backend that it tries
    try:
        plotter = pyvista.Plotter(off_screen=True, lighting="none")
    finally:
        vtkLogger.SetStderrVerbosity(before)
    without_screen = plotter.render_window.GetClassName() == "vtkOSOpenGLRenderWindow"
    if without_screen and not find_library("OSMesa"):
        return None
    plotter.set_background("white")
    plotter.enable_anti_aliasing("msaa")
    plotter.add_light(pyvista.Light(position=(-0.4, 0.5, 1.0), light_type="camera light"))
    return plotter
