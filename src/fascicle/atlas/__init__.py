"""Hearts of the population, for recordings of people of whom there is no image."""
