"""Small mathematics that every room may use: no records, no parameters, no I/O.

Public:

- ``array_types``: names of NumPy array types for annotations (``F64``, ``I64``, ``Bool``).
- ``kernels``: decorators for compiled functions, and work shared out to threads.
- ``se3``: rotations, quaternions (xyzw) and rigid transforms.
- ``interpolation``: knots in time, the arc between attitudes and its rotation, for kernels.
- ``packed_covariance``: symmetric matrices as six numbers. ``hashing``: choice without order.
- ``normal_equations``: least squares with up to six unknowns, for kernels.
- ``run_concurrently``: two pieces of work at a time. ``large_arrays``: where large arrays lie.
- ``space_curve``: the order of points along a curve through space.
- ``sparse_diagonal``: diagonal matrices as sparse arrays.
"""
