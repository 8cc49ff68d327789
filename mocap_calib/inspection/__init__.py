"""What is in keypoint files, before any calibration.

`contents` has the numbers of each camera and each pair, `problems` what stands in the way of a run.
"""
