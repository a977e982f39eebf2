"""Volumes from LiDAR surveys with propagated covariance."""

import os

# Threads that have nothing to do sleep: by default they spin, which starves everything else on a
# small or busy computer. Read by the OpenMP runtime when the first parallel kernel starts.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
# So do those of NumPy's linear algebra, for milliseconds after each product: they double the time
# of an estimate, whose matrices are too small to share out, and would make its last digits those of
# the number of cores. Read when NumPy is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
