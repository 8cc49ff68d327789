"""Files of 3D poses, a module a format."""
