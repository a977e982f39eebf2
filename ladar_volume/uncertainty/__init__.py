"""From a gradient per surface point to a variance per error source.

Public:

- ``patch_table``: the current filtered surface, patch by patch, with what patches share.
- ``propagation``, ``load_kernels``: sums over points, pairs of patches and time bins.
- ``navigation_sum``: errors correlated in time, added up in one pass.
- ``smoothing``: what the fits smoothed away, and its line.
- ``volume_budget``, ``epoch_budget``: variances by source of one volume, and of a change.
- ``second_order``: where the first order is not enough.
- ``roughness``, ``ground_field``: the ground between its points as a random field.
- ``pass_agreement``, ``pass_differences``, ``variance_components``: whether passes and beams lie
  over each other as the budget says, and which group of sources is worse.
- ``correlated_sum``: the sigma of a sum over correlated height differences.

The mathematics is in docs/uncertainty.md.
"""
