"""Likely pairs of many pictures: those that share features, and neighbours by name."""

from types import SimpleNamespace

import numpy as np

from exmesh_graph.io.pairs import ENOUGH, LARGEST, likely_pairs, likeness, matched_pairs


class _Database:
    """Twelve pictures on a line: each shares features with the two before and the two after it."""

    def __init__(self):
        rng = np.random.default_rng(0)
        self.parts = [rng.integers(0, 256, (20, 128)).astype(np.uint8) for _ in range(14)]
        self.noise = rng.integers(0, 256, (12, 500, 128)).astype(np.uint8)
        self.small = rng.permutation(12)  # numbers do not follow names

    def read_all_images(self):
        return [SimpleNamespace(name=f"p{k:02d}", image_id=int(n)) for k, n in enumerate(self.small)]

    def _of(self, number):
        k = int(np.flatnonzero(self.small == number)[0])
        shared = np.concatenate(self.parts[k : k + 3])
        return np.concatenate([self.noise[k], shared]), np.r_[np.ones(500), np.full(60, 9.0)]

    def read_keypoints(self, number):
        scale = self._of(number)[1]
        zero = np.zeros_like(scale)
        return np.stack([zero, zero, scale, zero, zero, scale], axis=1)

    def read_descriptors(self, number):
        return SimpleNamespace(data=self._of(number)[0])

    def close(self):
        pass


def test_pairs_that_share_their_largest_features_are_matched_and_others_are_not(tmp_path):
    colmap = SimpleNamespace(Database=SimpleNamespace(open=lambda _: _Database()))
    pairs = likely_pairs(colmap, tmp_path, 6)
    assert pairs == [(f"p{i:02d}", f"p{j:02d}") for i in range(12) for j in range(i + 1, min(i + 3, 12))]


def test_features_count_where_they_are_nearest_to_one_another_and_clearly_so():
    rng = np.random.default_rng(1)
    one = rng.integers(0, 256, (LARGEST, 128)).astype(np.uint8)
    twice = np.concatenate([one[:30], one[:30]])  # each has a twin: not clear
    counts = likeness([one, one[:40], twice, one[:1], np.zeros((0, 128), np.uint8)])
    assert counts[0, 1] == counts[1, 0] == 40
    assert counts[0, 3] == counts[0, 4] == 0
    assert likeness([one[:40], twice])[0, 1] < 15
    assert not np.diag(counts).any()


def test_pictures_that_looked_alike_are_asked_again_and_those_that_look_like_few_with_all(tmp_path):
    """A ring of twenty, each like the eight nearest on either side, and one that looks like none."""
    ring = [(i, j) for i in range(1, 21) for j in range(i + 1, 21) if min(j - i, 20 - j + i) <= 8]
    unlike = [(i, j) for i in range(1, 21) for j in range(i + 1, 21) if (i, j) not in ring]

    class Database:
        def read_all_images(self):
            return [SimpleNamespace(name=f"p{number:02d}", image_id=number) for number in range(1, 22)]

        def read_num_matches(self):
            return [i * 100 + j for i, j in (*ring, *unlike)], [30] * len(ring) + [0] * len(unlike)

        def close(self):
            pass

    colmap = SimpleNamespace(
        Database=SimpleNamespace(open=lambda _: Database()), pair_id_to_image_pair=lambda pair: divmod(pair, 100)
    )
    expected = {(f"p{i:02d}", f"p{j:02d}") for i, j in (*ring, *((i, 21) for i in range(1, 21)))}
    pairs = matched_pairs(colmap, tmp_path)
    assert set(pairs) == expected
    assert pairs == sorted(expected)
    assert ENOUGH <= 16
    assert len(matched_pairs(colmap, tmp_path, enough=0)) == len(ring)  # of many pictures none is matched with all
