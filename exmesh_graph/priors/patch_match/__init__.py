"""Dense depth by slanted-plane PatchMatch (Bleyer et al. 2011; Xu and Tao 2019): `estimate.patch_match`."""
