// Trees and myocardium of a network, a block each: the paper's equations `eikotree` and `eikomyo`.
//
// `fascicle.kernels.coupled` explains the problem, and why its solution does not depend on the
// order in which times are lowered. Nodes are numbered mesh vertices first; then the sites, which
// are the leaves of the trees; then forks and roots. A node whose time was lowered waits. In each
// round those that wait and are early go on to what is around them, until none waits.

const int ROOM = 2048;  // nodes that are taken in a round; others go on waiting
const int LANES = 8;    // threads that share the elements and edges of a vertex
// Smallest decrease (ms) that is worth passing on
const double SETTLED = 1e-10;

struct Front {
    double* time;
    unsigned* waits;  // a bit a node
    int vertices, nodes;
};

struct Round {
    int taken[ROOM], fired[ROOM];
    int count, fires;
    double later;  // the earliest that goes on waiting
};

DEVICE void offer(const Front& f, int node, double arrival) {
    if (arrival < load(f.time + node) - SETTLED && arrival < atomic_min(f.time + node, arrival))
        atomic_or(f.waits + (node >> 5), 1u << (node & 31));
}

// The nodes that wait and are early enough; the threads share out the words of bits.
DEVICE void take(const Front& f, double until, Round& round) {
    BLOCK_FOR(word, (f.nodes + 31) / 32) {
        unsigned kept = 0;
        for (int bit = 0; bit < 32 && f.waits[word] >> bit; bit++) {
            if (!(f.waits[word] >> bit & 1)) continue;
            double time = f.time[32 * word + bit];
            int place = time <= until ? atomic_add(&round.count, 1) : ROOM;
            if (place < ROOM) {
                round.taken[place] = 32 * word + bit;
            } else {
                kept |= 1u << bit;
                atomic_min(&round.later, time);
            }
        }
        f.waits[word] = kept;
    }
}

DEVICE void through_edges(const Heart& h, const Front& f, int node, int lane) {
    double now = load(f.time + node);
    for (int k = h.link_start[node] + lane; k < h.link_start[node + 1]; k += LANES)
        offer(f, h.link[k], now + h.link_time[k]);
}

// PAIRS[s]: where, among the six pairs of corners, stand those of corner s with the others a, b, c,
// and the pairs ab, ac, bc
CONSTANT int PAIRS[4][6] = {
    {0, 1, 2, 3, 4, 5}, {0, 3, 4, 1, 2, 5}, {1, 3, 5, 0, 2, 4}, {2, 4, 5, 0, 1, 3}};

// Through one element of a vertex's star, to its three other corners, all of which have a time by
// now (`through_edges`). In names, s is the vertex, a, b, c the others, p the products and q the
// squared times.
DEVICE void through_element(const Heart& h, const Front& f, int node, int e) {
    int a = h.star[4 * e], b = h.star[4 * e + 1], c = h.star[4 * e + 2];
    double now = load(f.time + node), soonest = now + h.least[e];
    double ta = load(f.time + a), tb = load(f.time + b), tc = load(f.time + c);
    if (soonest >= ta && soonest >= tb && soonest >= tc) return;
    const double* p = h.solver + 12 * (h.star[4 * e + 3] >> 2);
    const double* q = p + 6;
    const int* pair = PAIRS[h.star[4 * e + 3] & 3];
    double psa = p[pair[0]], psb = p[pair[1]], psc = p[pair[2]];
    double pab = p[pair[3]], pac = p[pair[4]], pbc = p[pair[5]];
    double da = ta - now, db = tb - now, dc = tc - now;
    // where times rise no steeper than a front does, nothing in the element can be earlier
    double slope = -(psa * da * da + psb * db * db + psc * dc * dc + pab * (da - db) * (da - db) +
                   pac * (da - dc) * (da - dc) + pbc * (db - dc) * (db - dc));
    if (slope <= 1) return;
    double qsa = q[pair[0]], qsb = q[pair[1]], qsc = q[pair[2]];
    double qab = q[pair[3]], qac = q[pair[4]], qbc = q[pair[5]];
    if (soonest < ta) {
        Corner corner = {psa, pab, pac, psb, psc, pbc, qsa, qab, qac, qsb, qsc};
        offer(f, a, now + from_new_corner(corner, db, dc));
    }
    if (soonest < tb) {
        Corner corner = {psb, pab, pbc, psa, psc, pac, qsb, qab, qbc, qsa, qsc};
        offer(f, b, now + from_new_corner(corner, da, dc));
    }
    if (soonest < tc) {
        Corner corner = {psc, pac, pbc, psa, psb, pab, qsc, qac, qbc, qsa, qsb};
        offer(f, c, now + from_new_corner(corner, da, db));
    }
}

// From a node of the trees to its parent and its children.
DEVICE void through_tree(const Network& n, const Front& f, int node) {
    double now = load(f.time + f.vertices + node);
    if (n.up[node] >= 0) offer(f, f.vertices + n.up[node], now + n.up_length[node] / n.cv);
    for (int child = n.first_child[node]; child >= 0; child = n.next_child[child])
        offer(f, f.vertices + child, now + n.up_length[child] / n.cv);
}

// Earliest arrival at a site from the four faces of its tetrahedron.
DEVICE double arrival_inside(const Heart& h, const Site& s, const double* time) {
    const double* q = h.solver + 12 * s.element + 6;
    double best = INFINITE;
    for (int skip = 0; skip < 4; skip++) {
        int i = skip == 0 ? 1 : 0, j = skip < 2 ? 2 : 1, k = skip < 3 ? 3 : 2;
        double qi = s.to_corner[i], qj = s.to_corner[j], qk = s.to_corner[k];
        Gram gram = {qi, (qi + qj - q[PAIRS[skip][3]]) / 2, (qi + qk - q[PAIRS[skip][4]]) / 2,
                     qj, (qj + qk - q[PAIRS[skip][5]]) / 2, qk};
        best = least(best, from_face(gram, time[i], time[j], time[k]));
    }
    return best;
}

// From the corners of a site's element into its tree, if one of them has become earlier.
DEVICE void into_tree(const Heart& h, const Network& n, const Front& f, int site) {
    const Site& s = n.sites[site];
    if (s.element < 0) return;
    double time[4], earliest = INFINITE;
    bool changed = false;
    for (int c = 0; c < 4; c++) {
        time[c] = load(f.time + h.corners[4 * s.element + c]);
        earliest = least(earliest, time[c]);
        changed = changed || time[c] < n.seen[4 * site + c];
        n.seen[4 * site + c] = time[c];
    }
    if (!changed || earliest + n.retrograde >= load(f.time + f.vertices + site)) return;
    offer(f, f.vertices + site, n.retrograde + arrival_inside(h, s, time));
}

// From a site that fires to what is around it: vertices in its row of the travel-time table,
// corners of its element, other sites. The threads of the block share them out.
DEVICE void fire(const Heart& h, const Network& n, const Front& f, int site) {
    const Site& s = n.sites[site];
    if (s.element < 0) return;
    double now = load(f.time + f.vertices + site) + n.anterograde;
    int start = h.row_start[s.row], rays = h.row_start[s.row + 1] - start;
    BLOCK_FOR(k, rays + 4) {
        int vertex = k < rays ? h.row_vertex[start + k] : h.corners[4 * s.element + k - rays];
        double time = k < rays ? ray_time(h, s, start + k) : sqrt(s.to_corner[k - rays]);
        offer(f, vertex, now + time);
    }
    BLOCK_FOR(other, n.count) {
        if (other != site) {
            double time = ray_to_site(h, s, n.sites[other]);
            offer(f, f.vertices + other, now + time + n.retrograde);
        }
    }
}

// One round: the nodes that were taken, the sites among them, and the sites that read vertices.
DEVICE void go_on(const Heart& h, const Network& n, const Front& f, Round& round, int count) {
    BLOCK_FOR(i, count * LANES) {
        int node = round.taken[i / LANES];
        if (node < f.vertices) {
            through_edges(h, f, node, i % LANES);
        } else if (i % LANES == 0) {
            through_tree(n, f, node - f.vertices);
            if (node - f.vertices < n.count)
                round.fired[atomic_add(&round.fires, 1)] = node - f.vertices;
        }
    }
    SYNC;
    BLOCK_FOR(i, count * LANES) {
        int node = round.taken[i / LANES];
        if (node < f.vertices)
            for (int e = h.star_start[node] + i % LANES; e < h.star_start[node + 1]; e += LANES)
                through_element(h, f, node, e);
    }
    if (n.anterograde < INFINITE)
        for (int k = 0; k < round.fires; k++) fire(h, n, f, round.fired[k]);
    if (n.retrograde < INFINITE) BLOCK_FOR(site, n.count) into_tree(h, n, f, site);
    SYNC;
}

DEVICE void begin(const Network& n, const Front& f) {
    BLOCK_FOR(node, f.nodes) f.time[node] = INFINITE;
    BLOCK_FOR(word, (f.nodes + 31) / 32) f.waits[word] = 0;
    BLOCK_FOR(i, 4 * n.count) n.seen[i] = INFINITE;
    SYNC;
    ONCE for (int side = 0; side < 2; side++) offer(f, f.vertices + n.root[side], n.fires[side]);
    SYNC;
}

DEVICE void until_none_waits(const Heart& h, const Network& n, const Front& f) {
    SHARED Round round;
    double until = 0;
    for (;;) {
        ONCE {
            round.count = round.fires = 0;
            round.later = INFINITE;
        }
        SYNC;
        take(f, until, round);
        SYNC;
        int count = round.count < ROOM ? round.count : ROOM;
        double later = round.later;
        if (count > 0) {
            go_on(h, n, f, round, count);
            continue;
        }
        if (!(later < INFINITE)) return;
        until = later + h.band;
        SYNC;
    }
}

// Activation (ms), and when the first and the last vertex of those reached have theirs.
DEVICE void finish(const Batch& b, const Network& n, const Front& f) {
    SHARED double first, last;
    ONCE {
        first = INFINITE;
        last = 0;
    }
    SYNC;
    double* found = b.time + BLOCK * b.most_nodes;
    BLOCK_FOR(node, f.nodes) {
        double time = f.time[node] / n.tissue_speed;
        found[node] = time;
        if (node < f.vertices && time < INFINITE) {
            atomic_min(&first, time);
            atomic_max(&last, time);
        }
    }
    SYNC;
    ONCE {
        b.first[BLOCK] = first;
        b.last[BLOCK] = last;
    }
}

KERNEL(solve) {
    Network n = network(*batch, BLOCK);
    if (n.count < 0) return;  // no network: it does not fit, or is not for the card
    Front f;
    f.vertices = heart->vertices;
    f.nodes = f.vertices + n.nodes;
    f.waits = (unsigned*)dynamic_shared;
    f.time = batch->times_are_shared ? (double*)(f.waits + (f.nodes + 63) / 64 * 2)
                                     : batch->time + BLOCK * batch->most_nodes;
    begin(n, f);
    until_none_waits(*heart, n, f);
    finish(*batch, n, f);
}
