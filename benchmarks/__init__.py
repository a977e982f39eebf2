from ladar_volume.process.switch import own_process

own_process()  # before NumPy, which reads then how many threads it may use
