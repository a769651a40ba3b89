// A block of threads: the names that kernels are written in.
//
// A kernel is a row of phases. In a phase the threads share out the items of one or several
// BLOCK_FOR loops; SYNC ends it. No variable of a thread's own lives across SYNC unless all threads
// hold the same value in it: then the same source also runs as C++ on a processor, where the tests
// prove it (tests/forward/device/block.h has these names for that).

#define KERNEL(name)                            \
    extern "C" __global__ void __launch_bounds__(512) \
        name(const Heart* heart, const Batch* batch)
#define DEVICE __device__ static
#define CONSTANT __device__ static const
#define SHARED __shared__
#define BLOCK ((int)blockIdx.x)
#define BLOCK_FOR(i, count) for (int i = threadIdx.x; i < (count); i += blockDim.x)
#define ONCE if (threadIdx.x == 0)
#define SYNC __syncthreads()

extern __shared__ long long dynamic_shared[];

#define INFINITE __longlong_as_double(0x7ff0000000000000LL)

// What another thread may be lowering at the same time.
DEVICE double load(const double* at) { return *(const volatile double*)at; }

// Lowers or raises a time, and gives what was there. Times are not negative: then their bits are
// in the order of the times.
DEVICE double atomic_min(double* at, double time) {
    return __longlong_as_double(atomicMin((long long*)at, __double_as_longlong(time)));
}
DEVICE double atomic_max(double* at, double time) {
    return __longlong_as_double(atomicMax((long long*)at, __double_as_longlong(time)));
}

DEVICE int atomic_add(int* at, int more) { return atomicAdd(at, more); }
DEVICE int atomic_exchange(int* at, int value) { return atomicExch(at, value); }
DEVICE void atomic_add(double* at, double more) { atomicAdd(at, more); }
DEVICE void atomic_or(unsigned* at, unsigned bits) { atomicOr(at, bits); }
