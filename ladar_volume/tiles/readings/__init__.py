"""What speaks against a ground by tiles: other readings of it, the toe, what is beside a body."""
