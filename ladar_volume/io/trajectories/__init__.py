"""Finished trajectories beside a point cloud: SBET and text, their accuracies, and their clocks."""
