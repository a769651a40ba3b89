"""The heart: tissue, endocardia, electrodes, and their validation."""
