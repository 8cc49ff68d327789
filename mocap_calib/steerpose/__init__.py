"""The SteerPose network: lifting detections, and training."""
