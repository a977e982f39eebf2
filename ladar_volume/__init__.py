"""Volumes from LiDAR surveys with propagated covariance."""

