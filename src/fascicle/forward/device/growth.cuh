// Growth of a tree, a block each; `fascicle.kernels.growth` explains it.
//
// To be compiled without fused multiply-add: then every operation rounds as on a processor, and
// the tree is the same to the last bit. In a round, there, branches move one after the other, and
// each sees the nodes that those before it have just laid. Here all move at the same time, seeing
// what the others laid when they last tried, until no move changes: as a move depends on those of
// earlier branches alone, these are the same moves.

const int GROWN = -1, TOO_LARGE = -2;  // status; else which stretch left the endocardium
const int GRID = 64;                   // cells per side of the hash that finds nearest nodes
CONSTANT double DIAMETER = 2.0;        // of the disk
CONSTANT double SOME_LEFT = 1e-300;    // mm

// As `fascicle.kernels.arrays.NODE`.
struct Node {
    double u, v;
    int branch, following, parent, triangle;
    double length;
};

const int MOST_FASCICLES = 4;

// What a tree grows by; of angles the cosine and sine, which need not round alike everywhere.
struct Plan {
    double u, v, a, b;  // the seed: where in the disk, heading
    double bundle, fascicle[MOST_FASCICLES], cosine[MOST_FASCICLES], sine[MOST_FASCICLES];
    double step, repulsion, too_near, branch_cosine, branch_sine;
    int triangle, fascicles, segments, generations;
};

struct Chart {
    const double *points, *metric;
    const int *triangles, *neighbours;
};

DEVICE Chart chart_of(const Heart& h, int side) {
    if (side == 0) return {h.lv_points, h.lv_metric, h.lv_triangles, h.lv_neighbours};
    return {h.rv_points, h.rv_metric, h.rv_triangles, h.rv_neighbours};
}

struct Point {
    double u, v;
    int triangle;
};

// A branch of the present generation, and what it tries in a round.
struct Sprout {
    double a, b;
    int start, end, alive, padding;
};
struct Move {
    double u, v, a, b;
    int triangle, laid;
};

struct Growth {
    Node* nodes;
    Sprout* sprouts;
    int size, count, label, changed, status;
    double missing;
    int head[GRID * GRID];
};

DEVICE double norm(const Chart& chart, int triangle, double a, double b) {
    const double* g = chart.metric + 3 * triangle;
    return sqrt(g[0] * a * a + 2.0 * g[1] * a * b + g[2] * b * b);
}

// Walks a length along a direction of the disk, triangle by triangle; what is left over at the base.
DEVICE double walk(Point& at, double a, double b, double length, const Chart& chart) {
    for (;;) {
        double speed = norm(chart, at.triangle, a, b), nearest = length / speed;
        int exit = -1;
        for (int k = 0; k < 3; k++) {
            const double* p = chart.points + 2 * chart.triangles[3 * at.triangle + (k + 1) % 3];
            const double* q = chart.points + 2 * chart.triangles[3 * at.triangle + (k + 2) % 3];
            double ex = q[0] - p[0], ey = q[1] - p[1], outwards = a * ey - b * ex;
            if (outwards > 0.0) {
                double gap = (p[0] - at.u) * ey - (p[1] - at.v) * ex;
                double distance = most(gap, 0.0) / outwards;
                if (distance < nearest) {
                    exit = k;
                    nearest = distance;
                }
            }
        }
        at.u += a * nearest;
        at.v += b * nearest;
        if (exit < 0) return 0.0;
        length -= nearest * speed;
        int across = chart.neighbours[3 * at.triangle + exit];
        if (across < 0) return most(length, SOME_LEFT);
        at.triangle = across;
    }
}

DEVICE int cell(double x) {
    int i = (int)((x + 1.0) * 0.5 * GRID);
    return i < 0 ? 0 : i < GRID ? i : GRID - 1;
}

// What is nearest to a point so far, and its squared distance (mm^2) in the metric there.
struct Near {
    double u, v, square;
};

DEVICE void nearer(Near& near, const Point& at, double u, double v, const double* g) {
    double x = at.u - u, y = at.v - v;
    double square = g[0] * x * x + 2.0 * g[1] * x * y + g[2] * y * y;
    if (square < near.square) near = {u, v, square};
}

// The nearest foreign node: of the tree, in which kin are the start of branch k, its own nodes, and
// those of its sister from `unseen` on; and of those that earlier branches lay in this round.
DEVICE void find_nearest(Near& near, const Point& at, const Growth& g, int k, int unseen,
                         const Move* moves, const Chart& chart) {
    int start = g.sprouts[k].start, own = g.label + k, sister = g.label + (k ^ 1);
    const double* metric = chart.metric + 3 * at.triangle;
    // the box around the ellipse of the distance so far
    double reach = near.square / (metric[0] * metric[2] - metric[1] * metric[1]);
    double du = least(sqrt(reach * metric[2]), DIAMETER);
    double dv = least(sqrt(reach * metric[0]), DIAMETER);
    for (int i = cell(at.u - du); i <= cell(at.u + du); i++)
        for (int j = cell(at.v - dv); j <= cell(at.v + dv); j++)
            for (int n = g.head[GRID * i + j]; n >= 0; n = g.nodes[n].following) {
                const Node& node = g.nodes[n];
                bool kin = n == start || node.branch == own ||
                           (node.branch == sister && n >= unseen);
                if (!kin) nearer(near, at, node.u, node.v, metric);
            }
    for (int j = 0; j < k; j++)
        if (moves[j].laid && j != (k ^ 1)) nearer(near, at, moves[j].u, moves[j].v, metric);
}

// Unit vector d plus w grad d_CP, but for the normalisation, which `walk` does.
DEVICE void steer(double& a, double& b, const Point& at, const Growth& g, const Plan& plan, int k,
                  const Move* moves, const Chart& chart) {
    // the sister is mostly the nearest, and if not, bounds the search; where it laid nothing, the
    // parent does, and nothing when the tree starts here
    int start = g.sprouts[k].start, beside = g.sprouts[k ^ 1].end;
    int guess = beside != start ? beside : g.nodes[start].parent;
    Near near = {0.0, 0.0, INFINITE};
    if (guess >= 0)
        nearer(near, at, g.nodes[guess].u, g.nodes[guess].v, chart.metric + 3 * at.triangle);
    find_nearest(near, at, g, k, g.size, moves, chart);
    double scale = norm(chart, at.triangle, a, b);
    a = a / scale;
    b = b / scale;
    if (near.square < INFINITE && near.square > 0.0) {
        double distance = sqrt(near.square);
        a += plan.repulsion * (at.u - near.u) / distance;
        b += plan.repulsion * (at.v - near.v) / distance;
    }
}

// The segment that branch k lays next, if earlier branches make these moves.
DEVICE Move next_move(const Growth& g, const Plan& plan, int k, int segment, const Move* moves,
                      const Chart& chart) {
    const Sprout& s = g.sprouts[k];
    const Node& end = g.nodes[s.end];
    Point at = {end.u, end.v, end.triangle};
    Move move = {0.0, 0.0, s.a, s.b, 0, 0};
    if (segment > 0) steer(move.a, move.b, at, g, plan, k, moves, chart);
    if (walk(at, move.a, move.b, plan.step, chart) > 0.0) return move;
    Near near = {0.0, 0.0, plan.too_near};
    // no node of the sister stops a branch: they begin nearer to each other than that
    find_nearest(near, at, g, k, 0, moves, chart);
    move.u = at.u;
    move.v = at.v;
    move.triangle = at.triangle;
    move.laid = !(near.square < plan.too_near);
    return move;
}

DEVICE void append(Growth& g, const Point& at, int parent, double length, int branch) {
    int* head = g.head + GRID * cell(at.u) + cell(at.v);
    g.nodes[g.size] = {at.u, at.v, branch, *head, parent, at.triangle, length};
    *head = g.size++;
}

// One round of a generation: all branches advance by a segment. What they end up doing is in the
// moves that are returned.
DEVICE const Move* advance(Growth& g, const Plan& plan, int segment, Move* moves, Move* others,
                           const Chart& chart) {
    BLOCK_FOR(k, g.count) moves[k].laid = others[k].laid = 0;
    for (;;) {
        ONCE g.changed = 0;
        SYNC;
        BLOCK_FOR(k, g.count) {
            if (g.sprouts[k].alive) {
                Move move = next_move(g, plan, k, segment, moves, chart);
                const Move& last = moves[k];
                bool same = move.laid == last.laid &&
                            (!move.laid || (move.u == last.u && move.v == last.v));
                if (!same) atomic_exchange(&g.changed, 1);
                others[k] = move;
            }
        }
        SYNC;
        if (!g.changed) return others;
        Move* swapped = moves;
        moves = others;
        others = swapped;
        SYNC;
    }
}

// Writes down what branches have laid, in their order.
DEVICE void settle(Growth& g, const Plan& plan, const Move* moves) {
    for (int k = 0; k < g.count; k++) {
        Sprout& s = g.sprouts[k];
        if (!s.alive) continue;
        s.alive = moves[k].laid;
        if (!s.alive) continue;
        append(g, {moves[k].u, moves[k].v, moves[k].triangle}, s.end, plan.step, g.label + k);
        s.end = g.size - 1;
        s.a = moves[k].a;
        s.b = moves[k].b;
    }
}

// A straight stretch from a node, the last segment shorter; false if it leaves the endocardium.
DEVICE bool lay(Growth& g, int& last, double a, double b, double length, double step, int branch,
                const Chart& chart) {
    for (double left = length; left > 0.0;) {
        double mm = least(step, left);
        Point at = {g.nodes[last].u, g.nodes[last].v, g.nodes[last].triangle};
        double missing = walk(at, a, b, mm, chart);
        append(g, at, last, mm - missing, branch);
        last = g.size - 1;
        left -= mm;
        if (missing > 0.0) {
            g.missing = left + missing;
            return false;
        }
    }
    return true;
}

// Two branches from a tip: the directions are the heading turned to the left and to the right.
DEVICE void branch_off(Growth& g, const Plan& plan, int k, int tip, double a, double b) {
    double c = plan.branch_cosine, s = plan.branch_sine;
    g.sprouts[k] = {c * a - s * b, s * a + c * b, tip, tip, 1, 0};
    g.sprouts[k + 1] = {c * a - -s * b, -s * a + c * b, tip, tip, 1, 0};
}

// Bundle and fascicles; where they end the first branches begin.
DEVICE void lay_bundles(Growth& g, const Plan& plan, const Chart& chart, long long most_grown) {
    double length = plan.bundle;
    for (int f = 0; f < plan.fascicles; f++) length += plan.fascicle[f];
    if (length / plan.step + 2 * (plan.fascicles + 1) > most_grown) {
        g.status = TOO_LARGE;
        return;
    }
    append(g, {plan.u, plan.v, plan.triangle}, -1, 0.0, 0);
    int fork = 0;
    if (!lay(g, fork, plan.a, plan.b, plan.bundle, plan.step, 0, chart)) {
        g.status = 0;
        return;
    }
    for (int f = 0; f < plan.fascicles; f++) {
        double c = plan.cosine[f], s = plan.sine[f];
        double a = c * plan.a - s * plan.b, b = s * plan.a + c * plan.b;
        int tip = fork;
        if (!lay(g, tip, a, b, plan.fascicle[f], plan.step, f + 1, chart)) {
            g.status = f + 1;
            return;
        }
        branch_off(g, plan, 2 * f, tip, a, b);
    }
    g.count = 2 * plan.fascicles;
    g.label = plan.fascicles + 1;
}

// From a generation to the next: two branches from the end of each that lives.
DEVICE void branch_again(Growth& g, const Plan& plan, int most_sprouts) {
    int living = 0;
    for (int k = 0; k < g.count; k++) living += g.sprouts[k].alive;
    g.label += g.count;
    if (2 * living > most_sprouts) {
        g.status = TOO_LARGE;
        return;
    }
    // the ends come to the front first, so that none is overwritten before it is read
    int end = 0;
    for (int k = 0; k < g.count; k++)
        if (g.sprouts[k].alive) g.sprouts[end++] = g.sprouts[k];
    for (int k = living - 1; k >= 0; k--) {
        Sprout tip = g.sprouts[k];
        branch_off(g, plan, 2 * k, tip.end, tip.a, tip.b);
    }
    g.count = 2 * living;
}

KERNEL(grow) {
    SHARED Growth g;
    int side = BLOCK % 2;
    const Plan& plan = batch->plans[BLOCK];
    Chart chart = chart_of(*heart, side);
    Move* moves = batch->moves + 2 * BLOCK * batch->most_sprouts;
    BLOCK_FOR(i, GRID * GRID) g.head[i] = -1;
    SYNC;
    ONCE {
        g.nodes = batch->nodes + BLOCK * batch->most_grown;
        g.sprouts = batch->sprouts + BLOCK * batch->most_sprouts;
        g.size = g.count = 0;
        g.status = GROWN;
        g.missing = 0.0;
        lay_bundles(g, plan, chart, batch->most_grown);
    }
    SYNC;
    for (int generation = 0; generation < plan.generations && g.count > 0; generation++) {
        for (int segment = 0; segment < plan.segments && g.status == GROWN; segment++) {
            if (g.size + g.count > batch->most_grown) {
                ONCE g.status = TOO_LARGE;
            } else {
                const Move* made =
                    advance(g, plan, segment, moves, moves + batch->most_sprouts, chart);
                ONCE settle(g, plan, made);
            }
            SYNC;
        }
        if (g.status != GROWN) break;
        ONCE branch_again(g, plan, (int)batch->most_sprouts);
        SYNC;
    }
    ONCE {
        batch->grown[BLOCK] = g.size;
        batch->status[BLOCK] = g.status;
        batch->missing[BLOCK] = g.missing;
        if (g.size > 0) batch->ends[BLOCK] = g.nodes[g.size - 1];
    }
}
