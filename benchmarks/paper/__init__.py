"""The protocol, tables and figures of the SteerPose paper."""
