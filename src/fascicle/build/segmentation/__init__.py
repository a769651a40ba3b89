"""From a segmented image to a labelled surface."""
