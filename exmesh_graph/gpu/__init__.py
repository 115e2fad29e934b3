"""What the rooms that compute stand on: Warp's run time, torch's set-up, the limits of 32-bit indices."""
