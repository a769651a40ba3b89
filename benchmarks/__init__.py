"""Measurements of accuracy and speed, and the synthetic recordings that tests share."""
