"""The filter stage: robust moving least squares on a stream (seed 002 chapter 4).

Public:

- ``surface_filter.SurfaceFilter``: the stage. Mapped points and platform states in; patches and
  filtered points out, the same in any order and batching.

Within: ``voxel_store`` (which raw points stay), ``patch_fit``, ``tangent_frame`` and
``refit_kernels`` (one patch, all patches), ``fit_store`` (fits kept between updates),
``cross_covariance`` and ``patch_sensitivity`` (what patches share), ``projection`` (filtered
points), ``deferral`` (points that wait their turn), ``patch_twin`` (the plain twin of the fit).

The filter for point cloud files is ``ladar_volume.clouds.filter_cloud``.
"""
