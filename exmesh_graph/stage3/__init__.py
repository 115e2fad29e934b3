"""The third stage: the shape under the light and the materials that the second one found."""
