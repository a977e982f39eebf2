"""Monte Carlo of whole surveys: do the printed intervals hold the truth?"""
