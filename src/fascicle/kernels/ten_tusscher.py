"""The human ventricular myocyte of ten Tusscher and Panfilov (2006).

Equations and constants: ten Tusscher and Panfilov, Am J Physiol Heart Circ Physiol 291 (2006)
H1088-H1100, and, for what that paper took over, ten Tusscher, Noble, Noble and Panfilov, 286 (2004)
H1573-H1589. The time constant of f2 is that of the authors' program, from which the CellML versions
differ. Units: mV, ms, mM, pA/pF, nS/pF, nL. Currents are per capacitance, so dV/dt = −I. Calcium
is in equilibrium with its buffers.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

from numba.extending import register_jitable

from fascicle.kernels.cable import CellModel, relaxed
from fascicle.kernels.jit import kernel

# Potential, gates, receptor, concentrations
Row = IntEnum(
    "Row", "V M H J D F F2 F_CASS R S XR1 XR2 XS R_PRIME CA_I CA_SR CA_SS NA_I K_I", start=0
)


class Constants(NamedTuple):
    """The constants of all types of cell."""

    faraday: float = 96485.3415  # C/mol
    rt_f: float = 8314.472 * 310.0 / 96485.3415  # mV, at 310 K
    na_o: float = 140.0  # mM, outside
    k_o: float = 5.4
    ca_o: float = 2.0
    v_c: float = 0.016404  # nL: cytoplasm, reticulum, subspace
    v_sr: float = 0.001094
    v_ss: float = 0.00005468
    capacitance: float = 0.185  # nF
    # mM/ms for 1 pA/pF of a monovalent ion into the cytoplasm, and of calcium into the subspace
    to_cytoplasm: float = 0.185 / (0.016404 * 96485.3415)
    to_subspace: float = 0.185 / (2 * 0.00005468 * 96485.3415)
    g_na: float = 14.838  # nS/pF
    g_k1: float = 5.405
    g_kr: float = 0.153
    g_bna: float = 0.00029
    g_bca: float = 0.000592
    g_pk: float = 0.0146
    g_cal: float = 3.98e-5  # cm³/(µF·s)
    p_nak: float = 2.724  # pA/pF, pump
    km_k: float = 1.0  # mM, pump
    km_na: float = 40.0
    p_kna: float = 0.03  # permeability of the slow rectifier to Na⁺, relative to K⁺
    k_naca: float = 1000.0  # pA/pF, exchanger
    gamma: float = 0.35
    k_sat: float = 0.1
    alpha: float = 2.5
    km_ca: float = 1.38  # mM, exchanger
    km_nai: float = 87.5
    g_pca: float = 0.1238  # pA/pF
    k_pca: float = 0.0005  # mM
    v_max_up: float = 0.006375  # mM/ms
    k_up: float = 0.00025  # mM
    v_rel: float = 0.102  # 1/ms
    v_leak: float = 0.00036
    v_xfer: float = 0.0038
    k1: float = 0.15  # 1/(mM²·ms)
    k2: float = 0.045  # 1/(mM·ms)
    k3: float = 0.06  # 1/ms
    k4: float = 0.005
    ec: float = 1.5  # mM
    max_sr: float = 2.5
    min_sr: float = 1.0
    buf_c: float = 0.2  # mM: buffers of cytoplasm, reticulum, subspace
    k_buf_c: float = 0.001
    buf_sr: float = 10.0
    k_buf_sr: float = 0.3
    buf_ss: float = 0.4
    k_buf_ss: float = 0.00025


C = Constants()


@kernel()
def _sigmoid(x):
    return 1.0 / (1.0 + math.exp(-x))


@kernel()
def _buffered(free, added, total, half):
    """Free calcium (mM) after `added` came in, in equilibrium with a buffer of `total` mM."""
    total_calcium = free + total * free / (free + half) + added
    b = total + half - total_calcium
    root = math.sqrt(b * b + 4.0 * half * total_calcium)
    return 2.0 * half * total_calcium / (root + b) if b > 0.0 else (root - b) / 2.0


@kernel()
def _sodium_gates(v, base, out, dt):
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
    out[Row.M] = relaxed(base[Row.M], m, tau_m, dt)
    out[Row.H] = relaxed(base[Row.H], inactivation, 1.0 / rate_h, dt)
    out[Row.J] = relaxed(base[Row.J], inactivation, 1.0 / rate_j, dt)


@kernel()
def _calcium_gates(v, ca_ss, base, out, dt):
    """Gates d, f, f2 and fCass of the L-type calcium current."""
    tau_d = (0.25 + 1.4 * _sigmoid((v + 35.0) / 13.0)) * 1.4 * _sigmoid(-(v + 5.0) / 5.0)
    tau_d += _sigmoid((v - 50.0) / 20.0)
    tau_f = 1102.5 * math.exp(-((v + 27.0) ** 2) / 225.0) + 200.0 * _sigmoid((v - 13.0) / 10.0)
    tau_f2 = 600.0 * math.exp(-((v + 25.0) ** 2) / 170.0) + 31.0 * _sigmoid((v - 25.0) / 10.0)
    falling = _sigmoid(-(v + 30.0) / 10.0)
    tau_f += 180.0 * falling + 20.0
    tau_f2 += 16.0 * falling
    bound = 1.0 / (1.0 + (ca_ss / 0.05) ** 2)
    out[Row.D] = relaxed(base[Row.D], _sigmoid((v + 8.0) / 7.5), tau_d, dt)
    out[Row.F] = relaxed(base[Row.F], _sigmoid(-(v + 20.0) / 7.0), tau_f, dt)
    out[Row.F2] = relaxed(base[Row.F2], 0.67 * _sigmoid(-(v + 35.0) / 7.0) + 0.33, tau_f2, dt)
    out[Row.F_CASS] = relaxed(base[Row.F_CASS], 0.6 * bound + 0.4, 80.0 * bound + 2.0, dt)


@kernel()
def _potassium_gates(v, base, out, cell, dt):
    """Gates r and s of the transient outward current, xr1, xr2, xs of the delayed rectifiers."""
    tau_r = 9.5 * math.exp(-((v + 40.0) ** 2) / 1800.0) + 0.8
    if cell[2] > 0.0:
        s = _sigmoid(-(v + 28.0) / 5.0)
        tau_s = 1000.0 * math.exp(-((v + 67.0) ** 2) / 1000.0) + 8.0
    else:
        s = _sigmoid(-(v + 20.0) / 5.0)
        tau_s = 85.0 * math.exp(-((v + 45.0) ** 2) / 320.0)
        tau_s += 5.0 * _sigmoid(-(v - 20.0) / 5.0) + 3.0
    tau_xr1 = 450.0 * _sigmoid((v + 45.0) / 10.0) * 6.0 * _sigmoid(-(v + 30.0) / 11.5)
    tau_xr2 = 3.0 * _sigmoid((v + 60.0) / 20.0) * 1.12 * _sigmoid(-(v - 60.0) / 20.0)
    tau_xs = 1400.0 * math.sqrt(_sigmoid((v - 5.0) / 6.0)) * _sigmoid(-(v - 35.0) / 15.0) + 80.0
    out[Row.R] = relaxed(base[Row.R], _sigmoid((v - 20.0) / 6.0), tau_r, dt)
    out[Row.S] = relaxed(base[Row.S], s, tau_s, dt)
    out[Row.XR1] = relaxed(base[Row.XR1], _sigmoid((v + 26.0) / 7.0), tau_xr1, dt)
    out[Row.XR2] = relaxed(base[Row.XR2], _sigmoid(-(v + 88.0) / 24.0), tau_xr2, dt)
    out[Row.XS] = relaxed(base[Row.XS], _sigmoid((v + 5.0) / 14.0), tau_xs, dt)


@kernel()
def _potassium_current(at, cell):
    """I_K1 + I_to + I_Kr + I_Ks + I_pK."""
    v, k_i = at[Row.V], at[Row.K_I]
    e_k = C.rt_f * math.log(C.k_o / k_i)
    e_ks = C.rt_f * math.log((C.k_o + C.p_kna * C.na_o) / (k_i + C.p_kna * at[Row.NA_I]))
    x = v - e_k
    alpha = 0.1 * _sigmoid(-0.06 * (x - 200.0))
    beta = (3.0 * math.exp(0.0002 * (x + 100.0)) + math.exp(0.1 * (x - 10.0))) * _sigmoid(0.5 * x)
    conductance = (
        C.g_k1 * math.sqrt(C.k_o / 5.4) * alpha / (alpha + beta)
        + cell[1] * at[Row.R] * at[Row.S]
        + C.g_kr * math.sqrt(C.k_o / 5.4) * at[Row.XR1] * at[Row.XR2]
        + C.g_pk * _sigmoid((v - 25.0) / 5.98)
    )
    return conductance * x + cell[0] * at[Row.XS] ** 2 * (v - e_ks)


@kernel()
def _l_type_current(at):
    """I_CaL, by Goldman, Hodgkin and Katz with the potential shifted by 15 mV."""
    z = 2.0 * (at[Row.V] - 15.0) / C.rt_f
    ratio = z / math.expm1(z) if abs(z) > 1e-9 else 1.0
    drive = 0.25 * at[Row.CA_SS] * math.exp(z) - C.ca_o
    open_ = at[Row.D] * at[Row.F] * at[Row.F2] * at[Row.F_CASS]
    return C.g_cal * open_ * 2.0 * C.faraday * ratio * drive


@kernel()
def _exchange(at):
    """I_NaCa and I_NaK."""
    v, na_i = at[Row.V], at[Row.NA_I]
    inward = math.exp((C.gamma - 1.0) * v / C.rt_f)
    exchanger = (
        C.k_naca
        * (
            math.exp(C.gamma * v / C.rt_f) * na_i**3 * C.ca_o
            - inward * C.na_o**3 * at[Row.CA_I] * C.alpha
        )
        / ((C.km_nai**3 + C.na_o**3) * (C.km_ca + C.ca_o) * (1.0 + C.k_sat * inward))
    )
    pump = C.p_nak * C.k_o / (C.k_o + C.km_k) * na_i / (na_i + C.km_na)
    pump /= 1.0 + 0.1245 * math.exp(-0.1 * v / C.rt_f) + 0.0353 * math.exp(-v / C.rt_f)
    return exchanger, pump


@kernel()
def _calcium_fluxes(at, base, out, l_type, membrane, dt):
    """Release, uptake, leak and diffusion between the three stores; `membrane` leaves the cell.

    `l_type` and `membrane` are currents (pA/pF) out of the subspace and out of the cytoplasm.
    """
    ca_i, ca_sr, ca_ss = at[Row.CA_I], at[Row.CA_SR], at[Row.CA_SS]
    k_casr = C.max_sr - (C.max_sr - C.min_sr) / (1.0 + (C.ec / ca_sr) ** 2)
    activation = C.k1 / k_casr * ca_ss**2
    release = C.v_rel * activation * at[Row.R_PRIME] / (C.k3 + activation) * (ca_sr - ca_ss)
    uptake = C.v_max_up / (1.0 + (C.k_up / ca_i) ** 2) - C.v_leak * (ca_sr - ca_i)
    across = C.v_xfer * (ca_ss - ca_i)
    rate = C.k2 * k_casr * ca_ss + C.k4
    out[Row.R_PRIME] = relaxed(base[Row.R_PRIME], C.k4 / rate, 1.0 / rate, dt)
    to_cytoplasm = across - uptake * C.v_sr / C.v_c - membrane * C.to_cytoplasm / 2.0
    to_subspace = release * C.v_sr / C.v_ss - across * C.v_c / C.v_ss - l_type * C.to_subspace
    out[Row.CA_I] = _buffered(base[Row.CA_I], dt * to_cytoplasm, C.buf_c, C.k_buf_c)
    out[Row.CA_SR] = _buffered(base[Row.CA_SR], dt * (uptake - release), C.buf_sr, C.k_buf_sr)
    out[Row.CA_SS] = _buffered(base[Row.CA_SS], dt * to_subspace, C.buf_ss, C.k_buf_ss)


@register_jitable
def advance(at, base, out, cell, stimulus, dt):
    """See `fascicle.kernels.cable.CellModel`; `cell` is G_Ks, G_to, and 1 if it is endocardial."""
    v, ca_i = at[Row.V], at[Row.CA_I]
    e_na = C.rt_f * math.log(C.na_o / at[Row.NA_I])
    e_ca = 0.5 * C.rt_f * math.log(C.ca_o / ca_i)
    potassium = _potassium_current(at, cell)
    l_type = _l_type_current(at)
    exchanger, pump = _exchange(at)
    sodium = (C.g_na * at[Row.M] ** 3 * at[Row.H] * at[Row.J] + C.g_bna) * (v - e_na)
    calcium = C.g_bca * (v - e_ca) + C.g_pca * ca_i / (ca_i + C.k_pca)
    total = potassium + l_type + exchanger + pump + sodium + calcium + stimulus
    _sodium_gates(v, base, out, dt)
    _calcium_gates(v, at[Row.CA_SS], base, out, dt)
    _potassium_gates(v, base, out, cell, dt)
    _calcium_fluxes(at, base, out, l_type, calcium - 2.0 * exchanger, dt)
    out[Row.V] = base[Row.V] - dt * total
    out[Row.NA_I] = base[Row.NA_I] - dt * C.to_cytoplasm * (sodium + 3.0 * (pump + exchanger))
    # the stimulus is carried by potassium, so charge is conserved
    out[Row.K_I] = base[Row.K_I] - dt * C.to_cytoplasm * (potassium + stimulus - 2.0 * pump)


# Conductances (nS/pF) of the slow delayed rectifier and of the transient outward current from the
# 2006 paper, and whether the latter inactivates slowly, as in endocardial cells; initial values of
# the CellML versions
CELLS = {
    cell.name: cell
    for cell in (
        CellModel(
            "endocardial", advance,
            (-86.709, 0.00155, 0.7573, 0.7225, 3.164e-5, 0.8009, 0.9778, 0.9953, 2.235e-8, 0.3212,
             0.00448, 0.476, 0.0087, 0.9068, 0.00013, 3.715, 0.00036, 10.355, 138.4),
            (0.392, 0.073, 1.0),
        ),
        CellModel(
            "midmyocardial", advance,
            (-85.423, 0.00165, 0.749, 0.6788, 3.288e-5, 0.7026, 0.9526, 0.9942, 2.347e-8, 0.999998,
             0.0165, 0.473, 0.0174, 0.8978, 0.000153, 4.272, 0.00042, 10.132, 138.52),
            (0.098, 0.294, 0.0),
        ),
        CellModel(
            "epicardial", advance,
            (-85.23, 0.00172, 0.7444, 0.7045, 3.373e-5, 0.7888, 0.9755, 0.9953, 2.42e-8, 0.999998,
             0.00621, 0.4712, 0.0095, 0.9073, 0.000126, 3.64, 0.00036, 8.604, 136.89),
            (0.392, 0.294, 0.0),
        ),
    )
}  # fmt: skip
