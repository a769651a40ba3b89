"""Which part of an unlabelled surface is which."""
