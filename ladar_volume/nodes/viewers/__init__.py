"""Who looks on: nodes that show what the others publish, and change nothing."""
