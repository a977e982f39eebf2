"""What a log of the nodes says of itself."""
