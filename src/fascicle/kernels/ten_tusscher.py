"""The human ventricular myocyte of ten Tusscher and Panfilov (2006), alone and in a cable.

Equations and constants: K. H. W. J. ten Tusscher and A. V. Panfilov, Alternans and spiral breakup
in a human ventricular tissue model, Am J Physiol Heart Circ Physiol 291 (2006) H1088-H1100, and,
for what that paper took over, ten Tusscher, Noble, Noble and Panfilov, Am J Physiol Heart Circ
Physiol 286 (2004) H1573-H1589. The time constant of f2 is that of the authors' program, from which
the CellML versions differ. Units: mV, ms, mM, pA/pF, nS/pF, nL. Currents are per capacitance, so
dV/dt = −I.

Second order in time: a half step with the rates at its start, then the whole step with the rates at
the middle. Gates and the ryanodine receptor follow their exponentials (Rush and Larsen, IEEE Trans
Biomed Eng 25 (1978) 389-392; in this midpoint form, Sundnes et al., IEEE Trans Biomed Eng 56 (2009)
2546-2548), the calciums are bound to their buffers in equilibrium.
"""

import math

import numpy as np

from fascicle.kernels.jit import allocating_kernel, kernel

# Rows of a state: potential, gates, receptor, concentrations
(V, M, H, J, D, F, F2, F_CASS, R, S, XR1, XR2, XS, R_PRIME,
 CA_I, CA_SR, CA_SS, NA_I, K_I) = range(19)  # fmt: skip

# What the layers of the wall differ in: conductances (nS/pF) of the slow delayed rectifier and the
# transient outward current, and whether the latter's inactivation is the endocardial one
G_KS, G_TO, ENDOCARDIAL = range(3)

GAS = 8314.472  # J/(kmol·K)
TEMPERATURE = 310.0  # K
FARADAY = 96485.3415  # C/mol
RT_F = GAS * TEMPERATURE / FARADAY  # mV

NA_O, K_O, CA_O = 140.0, 5.4, 2.0  # mM, outside
V_C, V_SR, V_SS = 0.016404, 0.001094, 0.00005468  # nL, cytoplasm, reticulum, subspace
CAPACITANCE = 0.185  # nF
# mM/ms for 1 pA/pF of a monovalent ion into the cytoplasm, and of calcium into the subspace
TO_CYTOPLASM = CAPACITANCE / (V_C * FARADAY)
TO_SUBSPACE = CAPACITANCE / (2 * V_SS * FARADAY)

G_NA, G_K1, G_KR = 14.838, 5.405, 0.153  # nS/pF
G_BNA, G_BCA, G_PK = 0.00029, 0.000592, 0.0146  # nS/pF
G_CAL = 3.98e-5  # cm³/(µF·s)
P_NAK = 2.724  # pA/pF
KM_K, KM_NA = 1.0, 40.0  # mM, pump
P_KNA = 0.03  # permeability of the slow rectifier to Na⁺, relative to K⁺
K_NACA = 1000.0  # pA/pF
GAMMA, K_SAT, ALPHA = 0.35, 0.1, 2.5  # exchanger
KM_CA, KM_NAI = 1.38, 87.5  # mM, exchanger
G_PCA, K_PCA = 0.1238, 0.0005  # pA/pF, mM
V_MAX_UP, K_UP = 0.006375, 0.00025  # mM/ms, mM
V_REL, V_LEAK, V_XFER = 0.102, 0.00036, 0.0038  # 1/ms
K1, K2, K3, K4 = 0.15, 0.045, 0.06, 0.005  # 1/(mM²·ms), 1/(mM·ms), 1/ms, 1/ms
EC, MAX_SR, MIN_SR = 1.5, 2.5, 1.0  # mM, 1, 1
BUF_C, K_BUF_C = 0.2, 0.001  # mM
BUF_SR, K_BUF_SR = 10.0, 0.3  # mM
BUF_SS, K_BUF_SS = 0.4, 0.00025  # mM


@kernel()
def _sigmoid(x):
    return 1.0 / (1.0 + math.exp(-x))


@kernel()
def _relaxed(gate, steady, tau, dt):
    """A gate after dt at constant steady state and time constant."""
    return steady + (gate - steady) * math.exp(-dt / tau)


@kernel()
def _buffered(free, added, total, half):
    """Free calcium (mM) after `added` came in, in equilibrium with a buffer of `total` mM."""
    whole = free + total * free / (free + half) + added
    b = total + half - whole
    root = math.sqrt(b * b + 4.0 * half * whole)
    return 2.0 * half * whole / (root + b) if b > 0.0 else (root - b) / 2.0


@kernel()
def _sodium_gates(v, i, base, out, dt):
    """Gates m, h and j of the fast sodium current."""
    m = _sigmoid((v + 56.86) / 9.03) ** 2
    tau_m = _sigmoid((v + 60.0) / 5.0) * (
        0.1 * _sigmoid(-(v + 35.0) / 5.0) + 0.1 * _sigmoid(-(v - 50.0) / 200.0)
    )
    if v >= -40.0:
        rate_h = 0.77 / 0.13 * _sigmoid((v + 10.66) / 11.1)
        rate_j = 0.6 * math.exp(0.057 * v) * _sigmoid(0.1 * (v + 32.0))
    else:
        rate_h = (
            0.057 * math.exp(-(v + 80.0) / 6.8)
            + 2.7 * math.exp(0.079 * v)
            + 3.1e5 * math.exp(0.3485 * v)
        )
        rate_j = (
            (-2.5428e4 * math.exp(0.2444 * v) - 6.948e-6 * math.exp(-0.04391 * v))
            * (v + 37.78)
            * _sigmoid(-0.311 * (v + 79.23))
        ) + 0.02424 * math.exp(-0.01052 * v) * _sigmoid(0.1378 * (v + 40.14))
    inactivation = _sigmoid(-(v + 71.55) / 7.43) ** 2
    out[i, M] = _relaxed(base[i, M], m, tau_m, dt)
    out[i, H] = _relaxed(base[i, H], inactivation, 1.0 / rate_h, dt)
    out[i, J] = _relaxed(base[i, J], inactivation, 1.0 / rate_j, dt)


@kernel()
def _calcium_gates(v, ca_ss, i, base, out, dt):
    """Gates d, f, f2 and fCass of the L-type calcium current."""
    tau_d = (0.25 + 1.4 * _sigmoid((v + 35.0) / 13.0)) * 1.4 * _sigmoid(-(v + 5.0) / 5.0)
    tau_d += _sigmoid((v - 50.0) / 20.0)
    tau_f = 1102.5 * math.exp(-((v + 27.0) ** 2) / 225.0) + 200.0 * _sigmoid((v - 13.0) / 10.0)
    tau_f2 = 600.0 * math.exp(-((v + 25.0) ** 2) / 170.0) + 31.0 * _sigmoid((v - 25.0) / 10.0)
    falling = _sigmoid(-(v + 30.0) / 10.0)
    tau_f += 180.0 * falling + 20.0
    tau_f2 += 16.0 * falling
    bound = 1.0 / (1.0 + (ca_ss / 0.05) ** 2)
    out[i, D] = _relaxed(base[i, D], _sigmoid((v + 8.0) / 7.5), tau_d, dt)
    out[i, F] = _relaxed(base[i, F], _sigmoid(-(v + 20.0) / 7.0), tau_f, dt)
    out[i, F2] = _relaxed(base[i, F2], 0.67 * _sigmoid(-(v + 35.0) / 7.0) + 0.33, tau_f2, dt)
    out[i, F_CASS] = _relaxed(base[i, F_CASS], 0.6 * bound + 0.4, 80.0 * bound + 2.0, dt)


@kernel()
def _potassium_gates(v, i, base, out, cell, dt):
    """Gates r and s of the transient outward current, xr1, xr2, xs of the delayed rectifiers."""
    tau_r = 9.5 * math.exp(-((v + 40.0) ** 2) / 1800.0) + 0.8
    if cell[ENDOCARDIAL] > 0.0:
        s = _sigmoid(-(v + 28.0) / 5.0)
        tau_s = 1000.0 * math.exp(-((v + 67.0) ** 2) / 1000.0) + 8.0
    else:
        s = _sigmoid(-(v + 20.0) / 5.0)
        tau_s = 85.0 * math.exp(-((v + 45.0) ** 2) / 320.0)
        tau_s += 5.0 * _sigmoid(-(v - 20.0) / 5.0) + 3.0
    tau_xr1 = 450.0 * _sigmoid((v + 45.0) / 10.0) * 6.0 * _sigmoid(-(v + 30.0) / 11.5)
    tau_xr2 = 3.0 * _sigmoid((v + 60.0) / 20.0) * 1.12 * _sigmoid(-(v - 60.0) / 20.0)
    tau_xs = 1400.0 * math.sqrt(_sigmoid((v - 5.0) / 6.0)) * _sigmoid(-(v - 35.0) / 15.0) + 80.0
    out[i, R] = _relaxed(base[i, R], _sigmoid((v - 20.0) / 6.0), tau_r, dt)
    out[i, S] = _relaxed(base[i, S], s, tau_s, dt)
    out[i, XR1] = _relaxed(base[i, XR1], _sigmoid((v + 26.0) / 7.0), tau_xr1, dt)
    out[i, XR2] = _relaxed(base[i, XR2], _sigmoid(-(v + 88.0) / 24.0), tau_xr2, dt)
    out[i, XS] = _relaxed(base[i, XS], _sigmoid((v + 5.0) / 14.0), tau_xs, dt)


@kernel()
def _potassium_current(i, at, cell):
    """I_K1 + I_to + I_Kr + I_Ks + I_pK."""
    v, k_i = at[i, V], at[i, K_I]
    e_k = RT_F * math.log(K_O / k_i)
    e_ks = RT_F * math.log((K_O + P_KNA * NA_O) / (k_i + P_KNA * at[i, NA_I]))
    x = v - e_k
    alpha = 0.1 * _sigmoid(-0.06 * (x - 200.0))
    beta = (3.0 * math.exp(0.0002 * (x + 100.0)) + math.exp(0.1 * (x - 10.0))) * _sigmoid(0.5 * x)
    conductance = (
        G_K1 * math.sqrt(K_O / 5.4) * alpha / (alpha + beta)
        + cell[G_TO] * at[i, R] * at[i, S]
        + G_KR * math.sqrt(K_O / 5.4) * at[i, XR1] * at[i, XR2]
        + G_PK * _sigmoid((v - 25.0) / 5.98)
    )
    return conductance * x + cell[G_KS] * at[i, XS] ** 2 * (v - e_ks)


@kernel()
def _l_type_current(i, at):
    """I_CaL, by Goldman, Hodgkin and Katz with the potential shifted by 15 mV."""
    z = 2.0 * (at[i, V] - 15.0) / RT_F
    ratio = z / math.expm1(z) if abs(z) > 1e-9 else 1.0
    drive = 0.25 * at[i, CA_SS] * math.exp(z) - CA_O
    open_ = at[i, D] * at[i, F] * at[i, F2] * at[i, F_CASS]
    return G_CAL * open_ * 2.0 * FARADAY * ratio * drive


@kernel()
def _exchange(i, at):
    """I_NaCa and I_NaK."""
    v, na_i = at[i, V], at[i, NA_I]
    inward = math.exp((GAMMA - 1.0) * v / RT_F)
    exchanger = (
        K_NACA
        * (math.exp(GAMMA * v / RT_F) * na_i**3 * CA_O - inward * NA_O**3 * at[i, CA_I] * ALPHA)
        / ((KM_NAI**3 + NA_O**3) * (KM_CA + CA_O) * (1.0 + K_SAT * inward))
    )
    pump = P_NAK * K_O / (K_O + KM_K) * na_i / (na_i + KM_NA)
    pump /= 1.0 + 0.1245 * math.exp(-0.1 * v / RT_F) + 0.0353 * math.exp(-v / RT_F)
    return exchanger, pump


@kernel()
def _calcium_fluxes(i, at, base, out, l_type, membrane, dt):
    """Release, uptake, leak and diffusion between the three stores; `membrane` leaves the cell.

    `l_type` and `membrane` are currents (pA/pF) out of the subspace and out of the cytoplasm.
    """
    ca_i, ca_sr, ca_ss = at[i, CA_I], at[i, CA_SR], at[i, CA_SS]
    k_casr = MAX_SR - (MAX_SR - MIN_SR) / (1.0 + (EC / ca_sr) ** 2)
    activation = K1 / k_casr * ca_ss**2
    release = V_REL * activation * at[i, R_PRIME] / (K3 + activation) * (ca_sr - ca_ss)
    uptake = V_MAX_UP / (1.0 + (K_UP / ca_i) ** 2) - V_LEAK * (ca_sr - ca_i)
    across = V_XFER * (ca_ss - ca_i)
    rate = K2 * k_casr * ca_ss + K4
    out[i, R_PRIME] = _relaxed(base[i, R_PRIME], K4 / rate, 1.0 / rate, dt)
    to_cytoplasm = across - uptake * V_SR / V_C - membrane * TO_CYTOPLASM / 2.0
    to_subspace = release * V_SR / V_SS - across * V_C / V_SS - l_type * TO_SUBSPACE
    out[i, CA_I] = _buffered(base[i, CA_I], dt * to_cytoplasm, BUF_C, K_BUF_C)
    out[i, CA_SR] = _buffered(base[i, CA_SR], dt * (uptake - release), BUF_SR, K_BUF_SR)
    out[i, CA_SS] = _buffered(base[i, CA_SS], dt * to_subspace, BUF_SS, K_BUF_SS)


@kernel()
def _advance(i, at, base, out, cell, stimulus, dt):
    """Write the state dt after `base`, by the rates at the state `at`, to `out`."""
    v, ca_i = at[i, V], at[i, CA_I]
    e_na = RT_F * math.log(NA_O / at[i, NA_I])
    e_ca = 0.5 * RT_F * math.log(CA_O / ca_i)
    potassium = _potassium_current(i, at, cell)
    l_type = _l_type_current(i, at)
    exchanger, pump = _exchange(i, at)
    sodium = (G_NA * at[i, M] ** 3 * at[i, H] * at[i, J] + G_BNA) * (v - e_na)
    calcium = G_BCA * (v - e_ca) + G_PCA * ca_i / (ca_i + K_PCA)
    total = potassium + l_type + exchanger + pump + sodium + calcium + stimulus
    _sodium_gates(v, i, base, out, dt)
    _calcium_gates(v, at[i, CA_SS], i, base, out, dt)
    _potassium_gates(v, i, base, out, cell, dt)
    _calcium_fluxes(i, at, base, out, l_type, calcium - 2.0 * exchanger, dt)
    out[i, V] = base[i, V] - dt * total
    out[i, NA_I] = base[i, NA_I] - dt * TO_CYTOPLASM * (sodium + 3.0 * (pump + exchanger))
    # the stimulus is carried by potassium, so charge is conserved
    out[i, K_I] = base[i, K_I] - dt * TO_CYTOPLASM * (potassium + stimulus - 2.0 * pump)


@kernel()
def _react(i, state, middle, cell, stimulus, dt):
    """Advance cell i by dt without its neighbours; `middle` is room for a state."""
    _advance(i, state, state, middle, cell, stimulus, dt / 2.0)
    _advance(i, middle, state, state, cell, stimulus, dt)


@allocating_kernel()
def run_cell(state, cell, stimulus, stimulated, dt, steps):
    """Advance one cell.

    Parameters
    ----------
    state : (1, 19) array
        The cell; changed in place.
    cell : (3,) array
        G_Ks, G_to, and 1 for an endocardial cell.
    stimulus : float
        Current (pA/pF, negative depolarises) during the first `stimulated` steps.
    dt : float
        Step (ms).
    steps : int
        How many.

    Returns
    -------
    (steps,) array
        The potential (mV) after each step.
    """
    middle, trace = np.empty_like(state), np.empty(steps)
    for step in range(steps):
        current = stimulus if step < stimulated else 0.0
        _react(0, state, middle, cell, current, dt)
        trace[step] = state[0, V]
    return trace


@kernel()
def _factor(pivot, lambda_):
    """Factors of the tridiagonal matrix of `_diffuse`; ends reflect."""
    side, centre = 1.0 / 12.0 - lambda_ / 2.0, 10.0 / 12.0 + lambda_
    pivot[0] = 1.0 / centre
    for k in range(1, len(pivot)):
        above = 2.0 * side if k == 1 else side
        below = 2.0 * side if k == len(pivot) - 1 else side
        pivot[k] = 1.0 / (centre - below * above * pivot[k - 1])


@kernel()
def _diffuse(state, pivot, right, lambda_):
    """One step of Crank and Nicolson with the compact Laplacian, of fourth order in space.

    (1 + δ²/12 − λδ²/2) V⁺ = (1 + δ²/12 + λδ²/2) V with λ = D·step/dx² (Douglas, 1956).
    """
    n = len(pivot)
    side, centre = 1.0 / 12.0 + lambda_ / 2.0, 10.0 / 12.0 - lambda_
    for k in range(n):
        before = state[k - 1, V] if k > 0 else state[1, V]
        after = state[k + 1, V] if k < n - 1 else state[n - 2, V]
        right[k] = centre * state[k, V] + side * (before + after)
    side = 1.0 / 12.0 - lambda_ / 2.0
    for k in range(1, n):
        below = 2.0 * side if k == n - 1 else side
        right[k] -= below * pivot[k - 1] * right[k - 1]
    state[n - 1, V] = right[n - 1] * pivot[n - 1]
    for k in range(n - 2, -1, -1):
        above = 2.0 * side if k == 0 else side
        state[k, V] = (right[k] - above * state[k + 1, V]) * pivot[k]


@allocating_kernel()
def run_cable(state, cell, stimulus, lambda_, dt, steps, probes):
    """Advance a cable.

    Half a step of diffusion, a step of every cell, half a step of diffusion (Strang, 1968).

    Parameters
    ----------
    state : (n, 19) array
        Its cells; changed in place.
    cell : (3,) array
        See `run_cell`.
    stimulus : tuple of float, int, int
        Current (pA/pF), the number of steps that it lasts, and the number of cells, from the end of
        the cable on, that it goes into.
    lambda_ : float
        D·(dt/2)/dx².
    dt : float
        Step (ms).
    steps : int
        How many.
    probes : (p,) array of int
        Cells to record.

    Returns
    -------
    (steps, p) array
        Their potentials (mV) after each step.
    """
    amplitude, stimulated, reach = stimulus
    middle, traces = np.empty_like(state), np.empty((steps, len(probes)))
    pivot, right = np.empty(len(state)), np.empty(len(state))
    _factor(pivot, lambda_)
    for step in range(steps):
        _diffuse(state, pivot, right, lambda_)
        for i in range(len(pivot)):
            current = amplitude if step < stimulated and i < reach else 0.0
            _react(i, state, middle, cell, current, dt)
        _diffuse(state, pivot, right, lambda_)
        for p in range(len(probes)):
            traces[step, p] = state[probes[p], V]
    return traces
