"""What a finished asset is for: other light, other materials, a turntable."""
