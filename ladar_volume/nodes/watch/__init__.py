"""What a node knows of its own state and of its inputs, and how it says so."""
