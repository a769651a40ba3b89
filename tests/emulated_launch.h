// Runs a kernel, block after block; comes after the kernels.

typedef void (*Kernel)(const Heart*, const Batch*);

extern "C" void launch(Kernel kernel, int blocks, long long shared_bytes, int order,
                       const Heart* heart, const Batch* batch) {
    std::vector<long long> shared(shared_bytes / 8 + 1);
    dynamic_shared = shared.data();
    for (emulated_block = 0; emulated_block < blocks; emulated_block++) {
        std::fill(shared.begin(), shared.end(), 0x5555555555555555LL);  // anything
#ifdef THREADS
        std::barrier<> barrier(THREADS);
        emulated_barrier = &barrier;
        std::vector<std::thread> threads;
        for (int t = 0; t < THREADS; t++)
            threads.emplace_back([=] {
                emulated_thread = t;
                kernel(heart, batch);
            });
        for (auto& thread : threads) thread.join();
#else
        emulated_order = order;
        kernel(heart, batch);
#endif
    }
}
