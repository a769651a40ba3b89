// Where a network's junctions meet the myocardium, and its trees without the nodes between forks;
// a block a network. To be compiled without fused multiply-add, as the growth.

// Both trees of a network as one.
struct Trees {
    const Node* nodes[2];
    int size[2];
    int *children, *place;  // of each node: how many, and its number if it is significant or -1
};

DEVICE int side_of(const Trees& t, int i) { return i < t.size[0] ? 0 : 1; }
DEVICE const Node& node_of(const Trees& t, int i) {
    return i < t.size[0] ? t.nodes[0][i] : t.nodes[1][i - t.size[0]];
}
DEVICE int parent_of(const Trees& t, int i) {
    int parent = node_of(t, i).parent;
    return parent < 0 || i < t.size[0] ? parent : parent + t.size[0];
}

// Position of a node on its endocardium (mm).
DEVICE void lift(const Heart& h, int side, const Node& node, double* position) {
    const double* points = side == 0 ? h.lv_points : h.rv_points;
    const double* vertices = side == 0 ? h.lv_vertices : h.rv_vertices;
    const int* corner = (side == 0 ? h.lv_triangles : h.rv_triangles) + 3 * node.triangle;
    const double *p = points + 2 * corner[0], *q = points + 2 * corner[1];
    const double* r = points + 2 * corner[2];
    double x = node.u - p[0], y = node.v - p[1];
    double qx = q[0] - p[0], qy = q[1] - p[1], rx = r[0] - p[0], ry = r[1] - p[1];
    double area = qx * ry - qy * rx;
    double second = (x * ry - y * rx) / area, third = (qx * y - qy * x) / area;
    for (int d = 0; d < 3; d++)
        position[d] = (1.0 - second - third) * vertices[3 * corner[0] + d] +
                      second * vertices[3 * corner[1] + d] + third * vertices[3 * corner[2] + d];
}

DEVICE double dot(const double* p, const double* q) {
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
}

// Nearest point of the triangle a, a + ab, a + ac to a point, as weights of its second and third
// corner (C. Ericson, Real-Time Collision Detection, 2005, section 5.1.5).
DEVICE void nearest_in_triangle(const double* ab, const double* ac, const double* ap, double* w) {
    double d1 = dot(ab, ap), d2 = dot(ac, ap);
    double bp[3] = {ap[0] - ab[0], ap[1] - ab[1], ap[2] - ab[2]};
    double cp[3] = {ap[0] - ac[0], ap[1] - ac[1], ap[2] - ac[2]};
    double d3 = dot(ab, bp), d4 = dot(ac, bp), d5 = dot(ab, cp), d6 = dot(ac, cp);
    double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
    w[0] = w[1] = 0.0;
    if (d1 <= 0.0 && d2 <= 0.0) return;
    if (d3 >= 0.0 && d4 <= d3) {
        w[0] = 1.0;
    } else if (vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0) {
        w[0] = d1 / (d1 - d3);
    } else if (d6 >= 0.0 && d5 <= d6) {
        w[1] = 1.0;
    } else if (vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0) {
        w[1] = d2 / (d2 - d6);
    } else if (va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0) {
        w[1] = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        w[0] = 1.0 - w[1];
    } else {
        w[0] = vb / (va + vb + vc);
        w[1] = vc / (va + vb + vc);
    }
}

// Nearest point of a boundary triangle of the mesh; its squared distance (mm^2).
DEVICE double nearest_on_surface(const Heart& h, int triangle, const double* from, double* found) {
    const double* a = h.positions + 3 * h.surface[3 * triangle];
    const double* b = h.positions + 3 * h.surface[3 * triangle + 1];
    const double* c = h.positions + 3 * h.surface[3 * triangle + 2];
    double ab[3], ac[3], ap[3], w[2];
    for (int d = 0; d < 3; d++) {
        ab[d] = b[d] - a[d];
        ac[d] = c[d] - a[d];
        ap[d] = from[d] - a[d];
    }
    nearest_in_triangle(ab, ac, ap, w);
    for (int d = 0; d < 3; d++) found[d] = a[d] + w[0] * ab[d] + w[1] * ac[d];
    return square_distance(found, from);
}

// Columns of `fascicle.kernels.arrays.EikonalMesh.cells`
const int GRADIENT_X = 0, GRADIENT_Y = 4, GRADIENT_Z = 8, AT_ORIGIN = 12, XX = 16, CELL_COLUMNS = 22;

// Barycentric coordinates of a site, and squared travel times to the corners of its tetrahedron.
DEVICE void locate(const Heart& h, Site& s) {
    const double *cell = h.cells + CELL_COLUMNS * (long long)s.element, *m = cell + XX;
    for (int c = 0; c < 4; c++) {
        s.barycentric[c] = cell[GRADIENT_X + c] * s.position[0] +
                           cell[GRADIENT_Y + c] * s.position[1] +
                           cell[GRADIENT_Z + c] * s.position[2] + cell[AT_ORIGIN + c];
        const double* corner = h.positions + 3 * h.corners[4 * s.element + c];
        double x = corner[0] - s.position[0], y = corner[1] - s.position[1];
        double z = corner[2] - s.position[2];
        double time = sqrt(m[0] * x * x + m[1] * y * y + m[2] * z * z +
                           2.0 * (m[3] * x * y + m[4] * x * z + m[5] * y * z));
        s.to_corner[c] = time * time;
    }
}

// What each of the six points of the table's row counts for a site.
DEVICE void weigh(const Heart& h, Site& s, int away) {
    int i = away == 0 ? 1 : 0, j = away < 2 ? 2 : 1, k = away < 3 ? 3 : 2;
    double a = s.barycentric[i], b = s.barycentric[j], c = s.barycentric[k];
    double monomial[6] = {a * a, b * b, c * c, a * b, a * c, b * c};
    for (int point = 0; point < 6; point++) {
        s.weight[point] = 0.0;
        for (int n = 0; n < 6; n++) s.weight[point] += h.basis[6 * n + point] * monomial[n];
    }
}

// Moves a junction to the tissue's surface. False where its rays are not in the table.
DEVICE bool attach_junction(const Heart& h, int side, const Node& node, Site& s) {
    double from[3], best = INFINITE, found[3];
    lift(h, side, node, from);
    const int* near = side == 0 ? h.lv_near : h.rv_near;
    const int* start = (side == 0 ? h.lv_near_start : h.rv_near_start) + node.triangle;
    int triangle = -1;
    for (int k = start[0]; k < start[1]; k++) {
        double square = nearest_on_surface(h, near[k], from, found);
        if (square < best) {
            best = square;
            triangle = near[k];
            for (int d = 0; d < 3; d++) s.position[d] = found[d];
        }
    }
    s.element = h.surface_element[triangle];
    s.row = h.surface_row[triangle];
    if (s.element < 0) return true;
    if (s.row < 0) return false;
    locate(h, s);
    weigh(h, s, h.surface_opposite[triangle]);
    return true;
}

// Numbers the leaves, then forks and roots.
DEVICE void number(const Trees& t, int* sites, int* forks) {
    int total = t.size[0] + t.size[1];
    BLOCK_FOR(i, total) t.children[i] = 0;
    ONCE *sites = *forks = 0;
    SYNC;
    BLOCK_FOR(i, total) {
        if (parent_of(t, i) >= 0) atomic_add(t.children + parent_of(t, i), 1);
    }
    SYNC;
    BLOCK_FOR(i, total) {
        bool leaf = t.children[i] == 0 && parent_of(t, i) >= 0;
        t.place[i] = leaf ? atomic_add(sites, 1) : -1;
    }
    SYNC;
    int first = *sites;
    BLOCK_FOR(i, total) {
        if (t.children[i] > 1 || parent_of(t, i) < 0) t.place[i] = first + atomic_add(forks, 1);
    }
    SYNC;
}

// Joins each significant node to the next one above it.
DEVICE void join(const Trees& t, const Network& n, int* root) {
    BLOCK_FOR(i, n.nodes) n.first_child[i] = -1;
    SYNC;
    BLOCK_FOR(i, t.size[0] + t.size[1]) {
        int place = t.place[i];
        if (place >= 0) {
            double length = 0.0;
            int above = i;
            do {
                length += node_of(t, above).length;
                above = parent_of(t, above);
            } while (above >= 0 && t.place[above] < 0);
            n.up[place] = above < 0 ? -1 : t.place[above];
            n.up_length[place] = length;
            if (above < 0)
                root[side_of(t, i)] = place;
            else
                n.next_child[place] = atomic_exchange(n.first_child + t.place[above], place);
        }
    }
}

KERNEL(attach) {
    SHARED int sites, forks, refused;
    Trees t;
    for (int side = 0; side < 2; side++) {
        int tree = 2 * BLOCK + side;
        t.nodes[side] = batch->nodes + tree * batch->most_grown;
        t.size[side] = batch->grown[tree];
    }
    t.children = batch->children + 2 * BLOCK * batch->most_grown;
    t.place = batch->place + 2 * BLOCK * batch->most_grown;
    ONCE {
        batch->site_count[BLOCK] = -1;
        batch->junctions[2 * BLOCK] = batch->junctions[2 * BLOCK + 1] = 0;
        refused = batch->status[2 * BLOCK] != GROWN || batch->status[2 * BLOCK + 1] != GROWN;
    }
    SYNC;
    if (refused) return;
    number(t, &sites, &forks);
    if (sites > batch->most_sites) return;
    ONCE batch->node_count[BLOCK] = sites + forks;
    SYNC;
    Network n = network(*batch, BLOCK);
    join(t, n, batch->root + 2 * BLOCK);
    BLOCK_FOR(i, t.size[0] + t.size[1]) {
        if (t.children[i] == 0 && t.place[i] < sites) {
            Site& site = n.sites[t.place[i]];
            site.node = i;
            atomic_add(batch->junctions + 2 * BLOCK + side_of(t, i), 1);
            if (!attach_junction(*heart, side_of(t, i), node_of(t, i), site))
                atomic_exchange(&refused, 1);
        }
    }
    SYNC;
    ONCE if (!refused) batch->site_count[BLOCK] = sites;
}
