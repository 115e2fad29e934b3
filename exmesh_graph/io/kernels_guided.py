"""The kernel of matches that a pair's geometry allows. Import through `guided`."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.func
def _see(
    feature: int,
    other: int,
    cosine: float,
    best: wp.array(dtype=float),
    second: wp.array(dtype=float),
    which: wp.array(dtype=int),
):
    if cosine > best[feature]:
        second[feature] = best[feature]
        best[feature] = cosine
        which[feature] = other
    elif cosine > second[feature]:
        second[feature] = cosine


@wp.kernel
def nearest_allowed(
    first: int,
    count: int,
    others: int,
    flat: int,
    products: wp.array(dtype=float),
    places: wp.array(dtype=wp.vec2d),
    lines: wp.array(dtype=wp.vec3d),
    widths: wp.array(dtype=wp.float64),
    other_widths: wp.array(dtype=wp.float64),
    length: wp.array(dtype=float),
    other_length: wp.array(dtype=float),
    best: wp.array(dtype=float),
    second: wp.array(dtype=float),
    which: wp.array(dtype=int),
    other_best: wp.array(dtype=float),
    other_second: wp.array(dtype=float),
    other_which: wp.array(dtype=int),
):
    """One thread: of `count` features from `first` on and all [others] of another picture the nearest to one another.

    By cosine: `products` [count others] of their descriptors over both lengths. What came before, in order, stays held.
    A feature allows places whose product with its line, squared, is at most the sum of the two `widths`; in a `flat`
    scene `lines` holds a place, and the distance from it takes the product's place.
    """
    for row in range(count):
        i = first + row
        line = lines[i]
        for j in range(others):
            place = places[j]
            off = line[0] * place[0] + line[1] * place[1] + line[2]
            square = off * off
            if flat == 1:
                across = line[0] - place[0]
                down = line[1] - place[1]
                square = across * across + down * down
            if square <= widths[i] + other_widths[j]:
                cosine = products[row * others + j] / length[i] / other_length[j]
                _see(i, j, cosine, best, second, which)
                _see(j, i, cosine, other_best, other_second, other_which)
