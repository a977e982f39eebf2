"""Piles within outlines that a user gives or that are found: one volume each, above every base that
tools of the trade offer, and their tonnes.

Public:

- ``toe_line``: the heights of a surface along an outline.
- ``toe_bases``: bases from that line: plane, quadratic, triangulated, lowest, mean, highest.
- ``pile_bases``: all bases of a pile, and what its surface holds above each.
- ``pile_volumes``: every pile above the base that was asked for and above the others; their sum.
- ``found_piles``: the bodies that rise above the ground, as piles.
- ``tonnage``: tonnes from a volume and a density.
"""
