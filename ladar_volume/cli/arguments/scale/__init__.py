"""Options of verbs for surveys larger than memory."""
