"""The objects, all procedural (CC0): each is of one scene, so that choosing and scoring share none."""
