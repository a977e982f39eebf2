"""Piles of a site on the command line: what is asked for, rows of the result, a table."""
