"""The lead fields as a function of what is not known of the torso."""
