"""Meshes of any kind: topology, volumes, quality, intersections, meshing."""
