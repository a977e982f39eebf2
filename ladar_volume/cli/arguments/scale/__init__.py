"""Options of verbs for surveys larger than memory, and for many surveys."""
