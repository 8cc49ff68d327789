"""The files that runs and stages write."""
