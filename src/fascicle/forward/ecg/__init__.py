"""The ECG integral."""
