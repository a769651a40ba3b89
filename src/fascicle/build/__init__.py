"""Building of hearts from an image, a surface or a mesh, and export to other software."""
