// Numbers and index arithmetic that all kernels share. The same text is compiled by NVRTC for a GPU and by a C++ compiler for the
// emulator of the tests, so it uses no header of CUDA.
//
// `real` is the type in which activations are stored: float, or bf16 where BF16 is defined. All arithmetic is in float.

#ifndef KERNEL
#define KERNEL extern "C" __global__ void
#endif
// Loops over `count` numbers; a grid may have fewer threads than that.
#define EACH(i, count) \
    for (unsigned i = blockIdx.x * blockDim.x + threadIdx.x; i < (count); i += blockDim.x * gridDim.x)

#ifdef BF16
struct alignas(2) real {
    unsigned short bits;
};
static __device__ __forceinline__ float load(const real *p, unsigned i) {
    return __uint_as_float((unsigned)p[i].bits << 16);
}
static __device__ __forceinline__ real rounded(float x) {
    unsigned bits = __float_as_uint(x);
    real result;
    // To nearest, ties to even; a NaN stays one.
    result.bits = x != x ? 0x7fc0 : (unsigned short)((bits + 0x7fff + ((bits >> 16) & 1)) >> 16);
    return result;
}
static __device__ __forceinline__ void store(real *p, unsigned i, float x) {
    p[i] = rounded(x);
}
#else
typedef float real;
#endif
static __device__ __forceinline__ void store(float *p, unsigned i, float x) {
    p[i] = x;
}
static __device__ __forceinline__ float load(const float *p, unsigned i) {
    return p[i];
}

// Four numbers that are read and written at once.
struct alignas(16) Four {
    float x[4];
};

#ifdef BF16
struct alignas(8) FourReals {
    real x[4];
};
static __device__ __forceinline__ Four load4(const real *p, unsigned i) {
    FourReals from = *(const FourReals *)(p + i);
    Four to;
    #pragma unroll
    for (int k = 0; k < 4; k++)
        to.x[k] = load(from.x, k);
    return to;
}
static __device__ __forceinline__ void store4(real *p, unsigned i, Four from) {
    FourReals to;
    #pragma unroll
    for (int k = 0; k < 4; k++)
        to.x[k] = rounded(from.x[k]);
    *(FourReals *)(p + i) = to;
}
#endif
static __device__ __forceinline__ void store4(float *p, unsigned i, Four from) {
    *(Four *)(p + i) = from;
}
static __device__ __forceinline__ Four load4(const float *p, unsigned i) {
    return *(const Four *)(p + i);
}

// Computes `count` numbers y from those of x by `f(x, index)`, four at a time.
template <class Y, class X, class F>
static __device__ __forceinline__ void map(Y *y, const X *x, unsigned count, F f) {
    EACH(four, count / 4) {
        Four v = load4(x, 4 * four);
        #pragma unroll
        for (int k = 0; k < 4; k++)
            v.x[k] = f(v.x[k], 4 * four + k);
        store4(y, 4 * four, v);
    }
    EACH(rest, count % 4) store(y, count / 4 * 4 + rest, f(load(x, count / 4 * 4 + rest), count / 4 * 4 + rest));
}

// The same from two arrays, by `f(a, b)`.
template <class Y, class A, class B, class F>
static __device__ __forceinline__ void map2(Y *y, const A *a, const B *b, unsigned count, F f) {
    EACH(four, count / 4) {
        Four v = load4(a, 4 * four), w = load4(b, 4 * four);
        #pragma unroll
        for (int k = 0; k < 4; k++)
            v.x[k] = f(v.x[k], w.x[k]);
        store4(y, 4 * four, v);
    }
    EACH(rest, count % 4) {
        unsigned i = count / 4 * 4 + rest;
        store(y, i, f(load(a, i), load(b, i)));
    }
}

// Sum over the 32 lanes of a warp; every lane receives it.
static __device__ __forceinline__ float warp_sum(float x) {
    for (int lanes = 16; lanes > 0; lanes /= 2)
        x += __shfl_xor_sync(0xffffffff, x, lanes);
    return x;
}

// Sum over the 256 threads of a block, for thread 0.
static __device__ __forceinline__ float block_sum(float x) {
    __shared__ float sums[8];
    x = warp_sum(x);
    if (threadIdx.x % 32 == 0)
        sums[threadIdx.x / 32] = x;
    __syncthreads();
    if (threadIdx.x == 0)
        for (int k = 1; k < 8; k++)
            x += sums[k];
    return x;
}

static __device__ __forceinline__ float warp_max(float x) {
    for (int lanes = 16; lanes > 0; lanes /= 2)
        x = fmaxf(x, __shfl_xor_sync(0xffffffff, x, lanes));
    return x;
}

static __device__ __forceinline__ float sigmoid(float x) {
    return 1.0f / (1.0f + expf(-x));
}

static __device__ __forceinline__ float softplus(float x) {
    return fmaxf(x, 0.0f) + log1pf(expf(-fabsf(x)));
}
