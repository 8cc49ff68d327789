"""Files of 3D poses of other programs, a module for each; `formats_poses` is the table of them."""
