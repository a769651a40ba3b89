"""Mesh files: VTK, Gmsh, openCARP and PLY."""
