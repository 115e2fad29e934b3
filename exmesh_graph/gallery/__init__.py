"""Pictures and models of results, as artifacts."""
