// The names of src/fascicle/forward/device/block.cuh for a processor.
//
// Plainly, the items of a BLOCK_FOR run one after the other, in the order that `arrange` asks for,
// and SYNC does nothing. With THREADS, threads share them out as on a card, and SYNC is a barrier.

#include <algorithm>
#include <atomic>
#include <barrier>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <numeric>
#include <random>
#include <thread>
#include <vector>

#define KERNEL(name) extern "C" void name(const Heart* heart, const Batch* batch)
#define DEVICE static inline
#define CONSTANT static const
#define BLOCK emulated_block
#define INFINITE std::numeric_limits<double>::infinity()

static int emulated_block;
static long long* dynamic_shared;

#ifdef THREADS
static std::barrier<>* emulated_barrier;
static thread_local int emulated_thread;
#define SHARED static
#define BLOCK_FOR(i, count) for (int i = emulated_thread; i < (count); i += THREADS)
#define ONCE if (emulated_thread == 0)
#define SYNC emulated_barrier->arrive_and_wait()
#else
static int emulated_order;  // 0 forward, 1 backward, else the seed of a permutation
struct Items {
    std::vector<int> order;
    explicit Items(int count) : order(std::max(count, 0)) {
        static std::mt19937 random(emulated_order);
        std::iota(order.begin(), order.end(), 0);
        if (emulated_order == 1) std::reverse(order.begin(), order.end());
        if (emulated_order > 1) std::shuffle(order.begin(), order.end(), random);
    }
};
#define SHARED static
#define BLOCK_FOR(i, count) for (int i : Items(count).order)
#define ONCE
#define SYNC
#endif

template <class T>
static T load(const T* at) {
    return std::atomic_ref<T>(*const_cast<T*>(at)).load(std::memory_order_relaxed);
}

static long long bits_of(double time) {
    long long bits;
    std::memcpy(&bits, &time, sizeof bits);
    return bits;
}

// By the bits, as on a card: a time below 0 would be seen.
template <class Better>
static double exchange_if(double* at, double time, Better better) {
    std::atomic_ref<double> there(*at);
    double before = there.load(std::memory_order_relaxed);
    while (better(bits_of(time), bits_of(before)) &&
           !there.compare_exchange_weak(before, time, std::memory_order_relaxed)) {
    }
    return before;
}

static double atomic_min(double* at, double time) { return exchange_if(at, time, std::less<long long>()); }
static double atomic_max(double* at, double time) { return exchange_if(at, time, std::greater<long long>()); }
static int atomic_add(int* at, int more) { return std::atomic_ref<int>(*at).fetch_add(more, std::memory_order_relaxed); }
static int atomic_exchange(int* at, int value) { return std::atomic_ref<int>(*at).exchange(value, std::memory_order_relaxed); }
static void atomic_add(double* at, double more) { std::atomic_ref<double>(*at).fetch_add(more, std::memory_order_relaxed); }
static void atomic_or(unsigned* at, unsigned bits) { std::atomic_ref<unsigned>(*at).fetch_or(bits, std::memory_order_relaxed); }
