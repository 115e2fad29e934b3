"""What a result is known by and where it is kept: fingerprints, keys, the store, leases."""
