"""From parameters to activation times and the ECG, and its mismatch with a recording."""
