"""The filter of seed 002 as published: Algorithm 1, sequential and order-dependent.

``published_filter`` runs it, ``published_sweep`` is its loop, ``plane_facets`` and
``published_quadric`` are its surfaces, ``random_samples`` its sampling, ``published_records`` its
numbers and ``filter_presets`` the settings of section 9.
"""
