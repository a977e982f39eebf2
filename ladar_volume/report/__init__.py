"""Pictures of results: ``figure`` of a volume, ``change`` of a change between two surveys."""
