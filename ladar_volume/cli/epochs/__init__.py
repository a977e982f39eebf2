"""``ladar_volume epochs``: what changed between two surveys of one place.

- ``verb.run``: the verb; it tells what the two inputs are.
- ``surveys``: recordings and results, with the whole budget.
- ``clouds``: point clouds and meshes, with the noise of their points.
- ``outputs``: what both read and write alike.
- ``rows``: the tables that a person sees.
"""
