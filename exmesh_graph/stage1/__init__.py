"""Stage I: optimise vertices and an appearance texture on a mesh-UV carrier against photographs (paper, section 4)."""
