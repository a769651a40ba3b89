"""From an anatomy (surfaces, a segmentation, a mesh) to a heart in a torso."""
