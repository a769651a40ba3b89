"""From an image, a surface or a mesh to a heart, and from a heart to other software."""
