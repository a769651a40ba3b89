"""Quality checks of a recording, by its own numbers."""
