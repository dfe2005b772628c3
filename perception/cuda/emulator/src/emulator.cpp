// Runs CUDA kernels on one thread of the CPU: block after block, and in a block each thread as a context of its own, which gives way at
// barriers and where a warp exchanges numbers.

#include <algorithm>
#include <cmath>
#include <cstring>
#include <ucontext.h>
#include <utility>
#include <vector>

struct Size {
    unsigned x, y, z;
};
static Size threadIdx, blockIdx, blockDim, gridDim;

#define __global__
#define __device__
#define __forceinline__ inline
#define __restrict__
#define __launch_bounds__(...)
// Blocks run one after the other, so one copy is enough.
#define __shared__ static

static inline float __uint_as_float(unsigned bits) {
    float x;
    memcpy(&x, &bits, 4);
    return x;
}
static inline unsigned __float_as_uint(float x) {
    unsigned bits;
    memcpy(&bits, &x, 4);
    return bits;
}

namespace {

const size_t STACK = 64 << 10;

struct Thread {
    ucontext_t context;
    std::vector<char> stack;
    unsigned index;
    // Barriers that this thread has reached, of its block and of its warp.
    unsigned long block_barriers, warp_barriers;
    bool done;
};

std::vector<Thread> threads;
ucontext_t scheduler;
unsigned current, count;
float exchanged[1024];
void (*kernel)(void **);
void **arguments;

void enter() {
    kernel(arguments);
    threads[current].done = true;
    swapcontext(&threads[current].context, &scheduler);
}

void give_way() {
    unsigned self = current;
    swapcontext(&threads[self].context, &scheduler);
}

// Runs until all threads of the range have reached as many barriers as this one.
void wait(unsigned long Thread::*barriers, unsigned first, unsigned end) {
    unsigned self = current;
    threads[self].*barriers += 1;
    for (;;) {
        bool all = true;
        for (unsigned k = first; k < end; k++)
            // A thread that has returned counts as waiting, as on a GPU.
            all = all && (threads[k].done || threads[k].*barriers >= threads[self].*barriers);
        if (all)
            return;
        give_way();
    }
}

}  // namespace

static void __syncthreads() {
    wait(&Thread::block_barriers, 0, count);
}

static float __shfl_xor_sync(unsigned, float x, int lanes) {
    unsigned self = current, first = self / 32 * 32, end = std::min(first + 32, count);
    exchanged[self] = x;
    wait(&Thread::warp_barriers, first, end);
    float other = exchanged[self ^ lanes];
    wait(&Thread::warp_barriers, first, end);
    return other;
}

// Both emulators have kernels of the same names.
#define KERNEL static void
#include "common.cu"
#include "pointwise.cu"
#include "reduce.cu"
#include "optimiser.cu"
#include "convolution.cu"
#include "scan.cu"

// Calls a kernel with arguments of the types that it declares.
template <class... A, size_t... I>
static void call(void (*f)(A...), void **arguments, std::index_sequence<I...>) {
    f(*(A *)arguments[I]...);
}
template <class... A>
static void call(void (*f)(A...), void **arguments) {
    call(f, arguments, std::index_sequence_for<A...>());
}
template <auto f>
static void run(void **arguments) {
    call(f, arguments);
}

struct Entry {
    const char *name;
    void (*run)(void **);
    // Whether its threads wait for each other.
    bool waits;
};
static const Entry TABLE[] = {
#include "table.inc"
};

// Runs a kernel; returns whether there is one of this name.
extern "C" bool ENTRY(const char *name, const unsigned blocks[3], unsigned thread_count, void **values) {
    const Entry *entry = nullptr;
    for (auto &known : TABLE)
        if (!strcmp(known.name, name))
            entry = &known;
    if (!entry)
        return false;
    kernel = entry->run;
    arguments = values;
    count = thread_count;
    gridDim = {blocks[0], blocks[1], blocks[2]};
    blockDim = {count, 1, 1};
    if (threads.size() < count)
        threads.resize(count);
    for (blockIdx.z = 0; blockIdx.z < gridDim.z; blockIdx.z++)
        for (blockIdx.y = 0; blockIdx.y < gridDim.y; blockIdx.y++)
            for (blockIdx.x = 0; blockIdx.x < gridDim.x; blockIdx.x++) {
                for (unsigned k = 0; !entry->waits && k < count; k++) {
                    threadIdx = {k, 0, 0};
                    kernel(arguments);
                }
                if (!entry->waits)
                    continue;
                for (unsigned k = 0; k < count; k++) {
                    Thread &thread = threads[k];
                    thread.stack.resize(STACK);
                    thread.block_barriers = thread.warp_barriers = 0;
                    thread.done = false;
                    getcontext(&thread.context);
                    thread.context.uc_stack.ss_sp = thread.stack.data();
                    thread.context.uc_stack.ss_size = STACK;
                    thread.context.uc_link = nullptr;
                    makecontext(&thread.context, enter, 0);
                }
                for (bool all = false; !all;) {
                    all = true;
                    for (unsigned k = 0; k < count; k++) {
                        if (threads[k].done)
                            continue;
                        current = k;
                        threadIdx = {k, 0, 0};
                        swapcontext(&scheduler, &threads[k].context);
                        all = all && threads[k].done;
                    }
                }
            }
    return true;
}
