"""Action potentials of cells in a cable, the template of the ECG."""
