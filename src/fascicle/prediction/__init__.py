"""Prediction of scenarios, such as pacing, over a population of networks."""
