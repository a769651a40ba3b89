// A network as its kernels see it: where the batch keeps it.

// A leaf of a tree, moved to the tissue's surface; `fascicle.kernels.arrays.Sites`.
struct Site {
    double position[3], barycentric[4];
    double to_corner[4];  // squared travel times (ms^2) to the corners of its tetrahedron
    double weight[6];     // of the six points of its row of the travel-time table
    int element;          // -1 where it meets no conducting tissue
    int row;              // of the travel-time table
    int node;             // of its tree, the left one's first
    int padding;
};

struct Network {
    Site* sites;
    int count, nodes;  // sites, and nodes that are significant: sites, forks and roots
    // of each significant node: the one above and the length between (mm); its children as a list
    int *up, *first_child, *next_child;
    double* up_length;
    const int* root;
    double* seen;  // times of the corners of each site's element when they were last looked at
    double fires[2], cv, anterograde, retrograde, tissue_speed;
};

// What of a network's parameters the solution needs, on the tissue's clock.
struct Beat {
    double fires[2], cv, anterograde, retrograde, tissue_speed;
};

DEVICE Network network(const Batch& b, int number) {
    Network n;
    long long first = number * b.most_tree_nodes;
    n.sites = b.sites + number * b.most_sites;
    n.count = b.site_count[number];
    n.nodes = b.node_count[number];
    n.up = b.up + first;
    n.first_child = b.first_child + first;
    n.next_child = b.next_child + first;
    n.up_length = b.up_length + first;
    n.root = b.root + 2 * number;
    n.seen = b.seen + 4 * number * b.most_sites;
    const Beat& beat = b.beats[number];
    n.fires[0] = beat.fires[0];
    n.fires[1] = beat.fires[1];
    n.cv = beat.cv;
    n.anterograde = beat.anterograde;
    n.retrograde = beat.retrograde;
    n.tissue_speed = beat.tissue_speed;
    return n;
}
