"""Results as files of other programs: what the verbs hand to ``io.export``."""
