"""What the nodes' services do before they answer."""
