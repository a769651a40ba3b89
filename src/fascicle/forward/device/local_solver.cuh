// Local solver of the anisotropic eikonal equation; `fascicle.kernels.local_solver` explains it.
//
// mu = (b + sqrt(b^2 - a(c - 1))) / a,  a = 1'Q1,  b = 1'Qt,  c = t'Qt,  Q = A^-1.

CONSTANT double FLAT = 1e-14;

DEVICE double least(double a, double b) { return b < a ? b : a; }
DEVICE double most(double a, double b) { return b > a ? b : a; }

// Earliest arrival through the inside of an edge; infinite where the minimum is at an end.
DEVICE double from_edge(double a11, double a12, double a22, double t1, double t2) {
    double det = a11 * a22 - a12 * a12;
    if (det <= FLAT * a11 * a22) return INFINITE;
    double q11 = a22, q12 = -a12, q22 = a11;  // det Q, so that a, b, c carry a factor det
    double s1 = q11 + q12, s2 = q12 + q22;
    double a = s1 + s2, base = least(t1, t2), d1 = t1 - base, d2 = t2 - base;
    double b = s1 * d1 + s2 * d2;
    double c = q11 * d1 * d1 + 2 * q12 * d1 * d2 + q22 * d2 * d2;
    double disc = b * b - a * (c - det);
    if (disc < 0) return INFINITE;
    double mu = (b + sqrt(disc)) / a, r1 = mu - d1, r2 = mu - d2;
    if (q11 * r1 + q12 * r2 < 0 || q12 * r1 + q22 * r2 < 0) return INFINITE;
    return base + mu;
}

// Gram matrix A_ij of a face's corners.
struct Gram {
    double a11, a12, a13, a22, a23, a33;
};

// Earliest arrival through the inside of a face; infinite where the minimum is on an edge.
DEVICE double from_inside_face(const Gram& g, double t1, double t2, double t3) {
    double q11 = g.a22 * g.a33 - g.a23 * g.a23;
    double q12 = g.a13 * g.a23 - g.a12 * g.a33;
    double q13 = g.a12 * g.a23 - g.a13 * g.a22;
    double det = g.a11 * q11 + g.a12 * q12 + g.a13 * q13;
    if (det <= FLAT * g.a11 * g.a22 * g.a33) return INFINITE;
    double q22 = g.a11 * g.a33 - g.a13 * g.a13;
    double q23 = g.a12 * g.a13 - g.a11 * g.a23;
    double q33 = g.a11 * g.a22 - g.a12 * g.a12;
    double base = least(least(t1, t2), t3), d1 = t1 - base, d2 = t2 - base, d3 = t3 - base;
    double s1 = q11 + q12 + q13, s2 = q12 + q22 + q23, s3 = q13 + q23 + q33;
    double v1 = q11 * d1 + q12 * d2 + q13 * d3;
    double v2 = q12 * d1 + q22 * d2 + q23 * d3;
    double v3 = q13 * d1 + q23 * d2 + q33 * d3;
    double a = s1 + s2 + s3, b = s1 * d1 + s2 * d2 + s3 * d3, c = v1 * d1 + v2 * d2 + v3 * d3;
    double disc = b * b - a * (c - det);
    if (disc < 0) return INFINITE;
    double mu = (b + sqrt(disc)) / a;
    if (mu * s1 < v1 || mu * s2 < v2 || mu * s3 < v3) return INFINITE;
    return base + mu;
}

// Earliest arrival from a face with its edges and vertices; times may be infinite.
DEVICE double from_face(const Gram& g, double t1, double t2, double t3) {
    bool has1 = t1 < INFINITE, has2 = t2 < INFINITE, has3 = t3 < INFINITE;
    double best = least(least(t1 + sqrt(g.a11), t2 + sqrt(g.a22)), t3 + sqrt(g.a33));
    if (has1 && has2) best = least(best, from_edge(g.a11, g.a12, g.a22, t1, t2));
    if (has1 && has3) best = least(best, from_edge(g.a11, g.a13, g.a33, t1, t3));
    if (has2 && has3) best = least(best, from_edge(g.a22, g.a23, g.a33, t2, t3));
    if (has1 && has2 && has3) best = least(best, from_inside_face(g, t1, t2, t3));
    return best;
}

// Products of the barycentric coordinates and squared times of the element a, s, j, k.
struct Corner {
    double pas, paj, pak, psj, psk, pjk;
    double ss, jj, kk, sj, sk;
};

// Delay after corner s with which its face s, j, k fires corner a through s; or infinite.
// tj, tk: times of j and k less that of s.
DEVICE double from_new_corner(const Corner& q, double tj, double tk) {
    double paa = -(q.pas + q.paj + q.pak), pjj = -(q.paj + q.psj + q.pjk);
    double pkk = -(q.pak + q.psk + q.pjk);
    double b = q.paj * tj + q.pak * tk;
    double vj = pjj * tj + q.pjk * tk, vk = q.pjk * tj + pkk * tk;
    double disc = b * b - paa * (vj * tj + vk * tk - 1);
    bool beyond_j = true, beyond_k = true;
    double delay = INFINITE;
    if (disc >= 0) {
        double mu = (sqrt(disc) - b) / paa;
        beyond_j = q.paj * mu + vj > 0;
        beyond_k = q.pak * mu + vk > 0;
        if (!(beyond_j || beyond_k) && q.pas * mu + q.psj * tj + q.psk * tk <= 0) delay = mu;
    }
    if (beyond_k)
        delay = least(delay, from_edge(q.ss, (q.ss + q.jj - q.sj) / 2, q.jj, 0, tj));
    if (beyond_j)
        delay = least(delay, from_edge(q.ss, (q.ss + q.kk - q.sk) / 2, q.kk, 0, tk));
    return delay;
}
