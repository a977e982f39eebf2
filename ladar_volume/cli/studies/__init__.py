"""``ladar_volume study``: the published experiments, one command each.

``study`` has the verb, ``study_bodies``, ``study_coverage`` and ``study_wild`` the commands, and
``study_record`` what all of them share. The experiments themselves are in
``ladar_volume.experiments``.
"""
