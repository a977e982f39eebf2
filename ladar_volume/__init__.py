"""Volumes from LiDAR surveys with propagated covariance. An import changes nothing outside."""
