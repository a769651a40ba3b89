"""The action potential of a cell in a cable."""
