"""What camera and lens do to light, found from photographs alone."""
