"""Volumes from LiDAR surveys with propagated covariance."""

import os

# Threads that have nothing to do sleep: by default they spin, which starves everything else on a small or busy computer. Read by the
# OpenMP runtime when the first parallel kernel starts.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
