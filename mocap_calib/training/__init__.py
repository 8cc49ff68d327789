"""Training of the lifting and steering networks."""
