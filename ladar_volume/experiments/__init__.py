"""Published experiments and studies, each with one command (``ladar_volume study NAME``).

They import the product. Of the product only that verb imports them. Public:

- ``nist``: the box experiment of NIST's TINvolume (seed 000): its tables and figures.
- ``thesis``: the RMLS thesis's filter, meshes and volumes (seed 002, Tables 9.1 to 9.4).
- ``landfill``: Kern's landfill pits (seed 003): spheres, two scans, volumes, densities.
- ``stockpile``: the precision of a stockpile's volume (seed 004), as published and corrected.
- ``coverage``: Monte Carlo of whole surveys: do the printed intervals hold the truth?
- ``wild``: surveys with troubles that no budget knows: is every wrong volume doubted?

Of each ``..._scene`` makes the data, ``..._tables`` and ``..._figures`` show what was found beside
what was published. True values stay here: the product never sees them. Seeds are fixed. What the
studies gave is in docs/study_*.md.

Published *methods* that a user may choose (``filter --set filter.order=published``, ``body
--repair``, ``volume --method``) are in the product: ``clouds.published``, ``mesh.local_published``,
``volume.published_methods``.
"""
