"""From pairs to a rig of all cameras, labels of all detections, and 3D poses."""
