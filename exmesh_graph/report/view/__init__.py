"""A page that shows an asset in any browser, without a network."""
