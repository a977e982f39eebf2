"""Published experiments and studies. They import the product; nothing of the product
imports them. ``nist`` is seed 000, ``thesis`` seed 002, ``landfill`` seed 003, ``stockpile`` seed
004, ``coverage`` the Monte Carlo of whole surveys.
"""
