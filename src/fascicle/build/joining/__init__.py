"""From separate surfaces to one closed surface."""
