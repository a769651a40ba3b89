"""Mesh files: VTK, Gmsh, openCARP and what meshio reads."""
