"""What a person sees of a result: tables on the screen, one module for each kind of result."""
