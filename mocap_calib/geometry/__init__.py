"""Pure functions on float64 arrays."""
