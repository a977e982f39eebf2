"""``ladar_volume study``: the published experiments, one command each."""
