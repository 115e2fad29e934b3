"""For all tests: one thread for torch, before anything loads it.

Tests run beside one another; OpenMP's threads, which spin for one another, made some of
them 20 times slower.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
