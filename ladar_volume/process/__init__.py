"""What a program of this package changes in its own process: environment, allocator, other
libraries. Nothing of it happens to a process that imports the package as a library.

Public: one switch, :func:`ladar_volume.process.switch.own_process`, turns it on. The command line
and the programs of the nodes call it first, before NumPy is loaded; tests and benchmarks call it
too. What each change saves:

=====================================  =============================================================
threads that wait sleep (OpenMP)       spinning threads starve everything else on two cores
NumPy's products on one thread         half the time of an estimate; digits that do not depend on
                                       the number of cores
NumPy's tools for tests and Fortran    8 MB of each process of nodes (``numpy_names``)
coverage left out of numba             5 MB (``import_guard``)
SciPy's linear algebra left out        a fifth of what a node without data holds (``memory``)
two malloc arenas, large blocks mapped what was freed goes back to the system (``memory``)
Fast DDS frees what was taken          one buffer for every message that ever waited (``memory``)
numba's intermediate code packed       tens of MB after the start of a node (``memory``)
=====================================  =============================================================

Results do not depend on the switch beyond the last digits of matrix products. One thing is not
behind it, since without it a process may abort: numba's threads are OpenMP's where nobody chose
otherwise (``numba_threads``).
"""
