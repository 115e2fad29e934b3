"""The test pack of toy nodes."""
