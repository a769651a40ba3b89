"""The heart, its parts, and the folder it is kept in."""
