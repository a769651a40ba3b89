"""Emulators of a heart's ECGs, classifiers of its recordings, and what they learn from."""
