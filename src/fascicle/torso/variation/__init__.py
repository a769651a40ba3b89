"""Lead fields as a function of unknown properties of the torso."""
