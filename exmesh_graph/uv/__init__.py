"""The UV atlas (paper section 4.3): unwrapping, texel rasterisation, dilation, transfer, validity."""
