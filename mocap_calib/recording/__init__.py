"""Views on one clock: joining files and cameras, names of joints, and the frames looked at."""
