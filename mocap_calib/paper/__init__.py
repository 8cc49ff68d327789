"""The solver of the SteerPose paper and the five-point baseline, as measured references."""
