"""What is in keypoint files, before any calibration.

`contents` has the numbers of each camera and each pair, `problems` what stands in the way of a run.
"""

from mocap_calib.inspection.contents import fill_image_sizes, inspect_views
from mocap_calib.inspection.finding import Finding
from mocap_calib.inspection.problems import find_problems

__all__ = ["Finding", "fill_image_sizes", "find_problems", "inspect_views"]
