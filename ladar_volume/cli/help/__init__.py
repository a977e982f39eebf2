"""What helps with the command line: examples, near misses, completion."""
