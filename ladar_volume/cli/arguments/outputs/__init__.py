"""Options of the files that results are written as."""
