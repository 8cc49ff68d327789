"""Pure functions on float64 arrays: rotations, lenses, two views, rays of many views."""
