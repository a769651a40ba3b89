"""What holds for any mesh: topology, volumes, quality, intersections, meshing."""
