"""Explicit vectors for kernels written in C++ (`warp.func_native`), on a CPU.

Warp's compiler knows the processor but leaves loops scalar; clang's vector types do not depend on it. Plain loops took
2.6 times as long in SSIM. Vectors have 8 lanes whatever the processor is: one AVX register, or two of NEON or SSE.
"""

LANES = 8

PRELUDE = f"""
    constexpr int LANES = {LANES};
    typedef float vf __attribute__((ext_vector_type({LANES}), aligned(4)));
#define LOAD(p) (*(const vf*)(p))
#define STORE(p, v) (*(vf*)(p) = (v))
"""
"""At the head of a snippet: `vf` is a vector of floats, LOAD and STORE take any address of a float."""


def padded(count: int) -> int:
    """`count` floats rounded up to whole vectors."""
    return -(-count // LANES) * LANES
