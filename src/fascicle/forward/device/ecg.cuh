// The ECG of a network, a block each: V(t) = -int Gi grad Vm . grad Z dx.
//
// `fascicle.kernels.deposit` explains the histogram of the elements' fronts over time; here the
// vertices gather what their elements leave at them, instead of the elements scattering it.

const int CHANNELS = 8;
CONSTANT double GAP = 0.05;  // bins; closer times of an element are moved apart
const int MARGIN = 1;        // bins before the first activation
const int TAIL = 6;          // and after the last

struct Histogram {
    double* bins;  // CHANNELS each
    double origin, width;  // peak of the first bin, and from one to the next (ms)
    int count;
};

// Adds the jump c s at time t (bins): third difference of hats, a quartic B-spline (times 4!).
DEVICE void smear(const Histogram& h, double t, double c, const double* s) {
    int first = (int)t;
    double g = t - first, f = 1.0 - g;
    double weight[5] = {f * f * f * f, 1.0 + f * (4.0 + f * (6.0 + f * (4.0 - 4.0 * f))),
                        11.0 + f * (12.0 - f * (6.0 + f * (12.0 - 6.0 * f))),
                        1.0 + g * (4.0 + g * (6.0 + g * (4.0 - 4.0 * g))), g * g * g * g};
    for (int i = 0; i < 5; i++)
        for (int n = 0; n < CHANNELS; n++)
            atomic_add(h.bins + CHANNELS * (first + i) + n, c * weight[i] * s[n]);
}

DEVICE void sort_pair(double& a, double& b) {
    double lower = least(a, b);
    b = most(a, b);
    a = lower;
}

// Value k of the isotonic regression of four numbers, by its max-min formula.
DEVICE double pooled(const double* y, int k) {
    double highest = -INFINITE;
    for (int i = 0; i <= k; i++) {
        double lowest = INFINITE, total = 0.0;
        for (int j = i; j < 4; j++) {
            total += y[j];
            if (j >= k) lowest = least(lowest, total / (j - i + 1));
        }
        highest = most(highest, lowest);
    }
    return highest;
}

// The times sorted and moved at least GAP apart, as little as possible.
DEVICE void spread(double* t) {
    sort_pair(t[0], t[1]);
    sort_pair(t[2], t[3]);
    sort_pair(t[0], t[2]);
    sort_pair(t[1], t[3]);
    sort_pair(t[1], t[2]);
    double y[4];
    for (int k = 0; k < 4; k++) y[k] = t[k] - k * GAP;
    for (int k = 0; k < 4; k++) t[k] = pooled(y, k) + k * GAP;
}

DEVICE double closest(const double* t) {
    double gap = INFINITE;
    for (int i = 0; i < 3; i++)
        for (int j = i + 1; j < 4; j++) gap = least(gap, fabs(t[i] - t[j]));
    return gap;
}

// -6/prod_j(t_k - t_j) over the 4! of `smear`.
DEVICE double jump(const double* t, int k) {
    double product = 1.0;
    for (int j = 0; j < 4; j++)
        if (j != k) product *= t[k] - t[j];
    return -0.25 / product;
}

// What corner `place` of an element leaves: at its vertex, to be smeared there in one go, or where
// times are close at the time that is number `place` of the spread ones.
DEVICE void leave(const Heart& heart, const Histogram& h, const double* time, int element, int place,
                  double* at_vertex) {
    double t[4], strength[CHANNELS];
    for (int c = 0; c < 4; c++) {
        t[c] = (time[heart.source_corners[4 * element + c]] - h.origin) / h.width;
        if (!(t[c] < INFINITE)) return;
    }
    const float* w = heart.source_weights + 3 * CHANNELS * (long long)element;
    for (int n = 0; n < CHANNELS; n++)
        strength[n] = w[n] * (t[1] - t[0]) + w[CHANNELS + n] * (t[2] - t[0]) +
                      w[2 * CHANNELS + n] * (t[3] - t[0]);
    if (closest(t) > GAP) {
        double c = jump(t, place);
        for (int n = 0; n < CHANNELS; n++) at_vertex[n] += c * strength[n];
    } else {
        spread(t);
        smear(h, t[place], jump(t, place), strength);
    }
}

DEVICE void deposit(const Heart& heart, const Histogram& h, const double* time) {
    BLOCK_FOR(i, CHANNELS * h.count) h.bins[i] = 0.0;
    SYNC;
    BLOCK_FOR(v, (int)heart.vertices) {
        double at_vertex[CHANNELS] = {0};
        for (int e = heart.source_start[v]; e < heart.source_start[v + 1]; e++)
            leave(heart, h, time, heart.source[e] >> 2, heart.source[e] & 3, at_vertex);
        if (time[v] < INFINITE) smear(h, (time[v] - h.origin) / h.width, 1.0, at_vertex);
    }
    SYNC;
}

// Three running sums over the bins.
DEVICE void accumulate(const Histogram& h) {
    BLOCK_FOR(n, CHANNELS) {
        double once = 0.0, twice = 0.0, thrice = 0.0;
        for (int i = 0; i < h.count; i++) {
            once += h.bins[CHANNELS * i + n];
            twice += once;
            thrice += twice;
            h.bins[CHANNELS * i + n] = h.width * thrice;
        }
    }
    SYNC;
}

// The histogram's convolution with the response to a bin, at every sample.
DEVICE void respond(const Heart& heart, const Histogram& h, int samples, double* found) {
    int stride = (int)heart.bins_per_step, length = (int)heart.response_length;
    BLOCK_FOR(i, CHANNELS * samples) {
        int n = i / CHANNELS, channel = i % CHANNELS;
        // value of the response for the first bin of the histogram; one less for each further one
        int value = n * stride + MARGIN - (int)heart.response_first;
        int from = value < length ? 0 : value - length + 1;
        double total = 0.0;
        for (int bin = from; bin < h.count && bin <= value; bin++)
            total += heart.response[value - bin] * h.bins[CHANNELS * bin + channel];
        found[samples * channel + n] = total;
    }
}

KERNEL(electrocardiogram) {
    int samples = batch->samples[BLOCK];
    if (samples == 0) return;  // no network
    Histogram h;
    h.width = heart->bin_width;
    h.origin = -MARGIN * h.width;  // no root fires before 0
    h.count = (int)((batch->last[BLOCK] - h.origin) / h.width) + TAIL;
    h.bins = batch->bins_are_shared ? (double*)dynamic_shared
                                    : batch->bins + BLOCK * CHANNELS * batch->most_bins;
    deposit(*heart, h, batch->time + BLOCK * batch->most_nodes);
    accumulate(h);
    respond(*heart, h, samples, batch->channels + BLOCK * CHANNELS * batch->most_samples);
}
