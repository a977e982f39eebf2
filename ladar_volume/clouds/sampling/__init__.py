"""How a cloud was sampled: what a file's points are before anything is fitted to them.

``distinct_points`` finds copies of points. ``rounding_step`` finds the step of rounded coordinates
and the variance it adds. ``isolation`` names points that stand alone. ``sampling_lines`` finds the
lines of a scanner, and ``trimmed_noise`` the noise of neighbourhoods that hold several of them.
``outline_place`` tells how far the sampled area goes on beyond its outermost points.
``height_axis`` tells which column holds heights, ``cloud_objects`` what stands on the surface,
``pair_objects`` what stands on one of two, and ``objects_beside`` what of it an outline holds.
"""
