import ladar_volume  # noqa: F401 - before NumPy, which reads then how many threads it may use
