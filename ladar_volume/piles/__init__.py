"""Piles within outlines that a user gives or that are found: one volume each, above every base that
tools of the trade offer, and their tonnes.

Public:

- ``toe_line``: the heights of a surface along an outline.
- ``toe_bases``: bases from that line: plane, quadratic, triangulated, lowest, mean, highest.
- ``pile_bases``: what the surface of a pile holds above each base.
- ``pile_site``: what is asked for, the site without its piles, all bases of a pile.
- ``pile_verdict``: one pile above the base that was asked for, and what speaks against it.
- ``pile_volumes``: every pile above that base and above the others; their sum.
- ``found_piles``: the bodies that rise above the ground, as piles.
- ``tonnage``: tonnes from a volume and a density.
"""
