"""The solver and the losses of the paper."""
