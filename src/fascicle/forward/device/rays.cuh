// Ray travel times from a site, as `fascicle.kernels.ray_travel_times` has them.

DEVICE double square_distance(const double* p, const double* q) {
    double x = p[0] - q[0], y = p[1] - q[1], z = p[2] - q[2];
    return x * x + y * y + z * z;
}

// To the vertex of an entry of the site's row: between the six points, but never faster than any
// fibre.
DEVICE double ray_time(const Heart& h, const Site& s, int entry) {
    const float* square = h.row_square + 6LL * entry;
    double between = 0;
    for (int i = 0; i < 6; i++) between += s.weight[i] * square[i];
    double gap = square_distance(s.position, h.positions + 3 * h.row_vertex[entry]);
    return sqrt(most(between, gap * (h.slowness * h.slowness)));
}

// To any vertex, infinite where there is no ray; vertices ascend in a row.
DEVICE double ray_to_vertex(const Heart& h, const Site& s, int vertex) {
    for (int c = 0; c < 4; c++)
        if (h.corners[4 * s.element + c] == vertex) return sqrt(s.to_corner[c]);
    int low = h.row_start[s.row], high = h.row_start[s.row + 1];
    while (low < high) {
        int middle = (low + high) / 2;
        if (h.row_vertex[middle] < vertex)
            low = middle + 1;
        else
            high = middle;
    }
    bool there = low < h.row_start[s.row + 1] && h.row_vertex[low] == vertex;
    return there ? ray_time(h, s, low) : INFINITE;
}

// To another site, from the times to the corners of its tetrahedron: exact in a uniform medium,
// where the interpolation of their squares less that of the edges' is the square. Never less than
// by any corner, nor faster than any fibre.
DEVICE double ray_to_site(const Heart& h, const Site& s, const Site& other) {
    double gap = square_distance(s.position, other.position);
    if (other.element < 0 || gap > h.site_reach * h.site_reach) return INFINITE;
    double square = 0, never_less = h.slowness * sqrt(gap);
    for (int c = 0; c < 4; c++) {
        double time = ray_to_vertex(h, s, h.corners[4 * other.element + c]);
        if (!(time < INFINITE)) return INFINITE;
        square += other.barycentric[c] * time * time;
        never_less = most(never_less, time - sqrt(other.to_corner[c]));
    }
    const double* edge = h.solver + 12LL * other.element + 6;
    for (int c = 0; c < 3; c++)
        for (int d = c + 1; d < 4; d++)
            square -= (other.barycentric[c] * other.barycentric[d]) * *edge++;
    return most(sqrt(most(square, 0)), never_less);
}
