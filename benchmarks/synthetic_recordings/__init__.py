"""Synthetic recordings whose beats, QRS ends and pacing spikes are known exactly."""
