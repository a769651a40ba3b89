"""Tempered sampling: posteriors and evidences that are known, and what two runs agree on."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtri

from fascicle.inference.tempered_sampling import agreement, pooled, temper

CENTRE = np.array([0.8, -0.5, 0.3])  # of the likelihood, along the directions it is narrow in
SD = np.array([0.05, 0.1, 0.4])  # of the posterior along them
AXES = np.linalg.qr(np.random.default_rng(7).standard_normal((13, 13)))[0]


def gaussian(points):
    """The likelihood of measurements of three combinations of 13 normal scores."""
    variance = 1 / (1 / SD**2 - 1)
    return -0.5 * ((ndtri(points) @ AXES[:, :3] - CENTRE) ** 2 / variance).sum(axis=1)


def modes(points):
    """Two modes, of which one has 0.3 of the posterior."""
    scores = ndtri(points)
    each = [-0.5 * (((scores - centre) / 0.2) ** 2).sum(axis=1) for centre in (1.2, -1.2)]
    return np.logaddexp(np.log(0.3) + each[0], np.log(0.7) + each[1])


def sample(seed, likelihoods=gaussian, dimension=13, particles=1000, **options):
    return temper(likelihoods, dimension, np.random.default_rng(seed), particles, **options)


@pytest.fixture(scope="module")
def runs():
    return [sample(seed) for seed in range(4)]


def test_evidence_mean_and_covariance_of_a_gaussian(runs):
    variance = 1 / (1 / SD**2 - 1)
    exact = 0.5 * np.log(variance / (1 + variance)) - 0.5 * CENTRE**2 / (1 + variance)
    evidences = [run.log_evidence for run in runs]
    assert np.mean(evidences) == pytest.approx(exact.sum(), abs=0.12)
    assert np.ptp(evidences) < 0.5
    mean, sd = np.zeros(13), np.ones(13)
    mean[:3], sd[:3] = CENTRE / (1 + variance), SD
    together = np.concatenate([(ndtri(run.points) @ AXES - mean) / sd for run in runs])
    assert together.mean(axis=0) == pytest.approx(np.zeros(13), abs=0.09)
    assert np.cov(together.T) == pytest.approx(np.eye(13), abs=0.12)
    assert runs[0].log_likelihoods == pytest.approx(gaussian(runs[0].points))
    assert max(run.evaluations for run in runs) < 100_000


def test_skewed_posteriors_at_an_edge():
    """Likelihoods u^a, whose posteriors are beta distributions and whose evidences are 1/(a+1)."""
    powers = np.array([1000.0, 30, 4, 4, 1, 0])
    run = sample(0, lambda points: (powers * np.log(points)).sum(axis=1), 6, 2000)
    assert run.log_evidence == pytest.approx(-np.log(powers + 1).sum(), abs=0.25)
    mean = (powers + 1) / (powers + 2)
    sd = np.sqrt((powers + 1) / (powers + 3)) / (powers + 2)
    assert (run.points.mean(axis=0) - mean) / sd == pytest.approx(np.zeros(6), abs=0.12)
    assert run.points.std(axis=0) / sd == pytest.approx(np.ones(6), abs=0.1)


def test_shares_of_two_modes_and_the_sample_size_they_leave():
    """Over many runs, shares scatter as those of so many independent draws."""
    found = [sample(seed, modes, 8, 400) for seed in range(20)]
    shares = np.array([(run.points[:, 0] < 0.5).mean() for run in found])
    assert shares.mean() == pytest.approx(0.7, abs=0.03)
    exact = 8 * (np.log(0.2 / np.sqrt(1.04)) - 0.5 * 1.2**2 / 1.04)
    assert np.mean([run.log_evidence for run in found]) == pytest.approx(exact, abs=0.12)
    scattered = 0.7 * 0.3 / ((shares - 0.7) ** 2).mean()
    said = np.mean([run.effective for run in found])
    assert 0.4 * scattered < said < 2.5 * scattered
    assert said < 0.8 * 400
    together = pooled(found)
    assert len(together.points) == 400
    assert (together.points[:, 0] < 0.5).mean() == pytest.approx(0.7, abs=0.04)
    assert together.log_evidence == pytest.approx(exact, abs=0.12)
    assert together.effective > 8 * said


def test_pooled_runs_weigh_their_evidence(runs):
    one, other = (
        replace(runs[k], points=np.full((1000, 2), 0.25 + k), log_evidence=e, effective=n)
        for k, (e, n) in enumerate([(np.log(3), 50.0), (0.0, 10.0)])
    )
    both = pooled([one, other])
    assert np.unique(both.points[:, 0], return_counts=True)[1].tolist() == [750, 250]
    assert both.log_evidence == pytest.approx(np.log(2))
    assert both.effective == pytest.approx(1 / (0.75**2 / 50 + 0.25**2 / 10))
    assert both.evaluations == runs[0].evaluations + runs[1].evaluations
    assert pooled([runs[2]]).points.tobytes() == runs[2].points.tobytes()


def test_half_of_the_prior_without_a_likelihood():
    def likelihoods(points):
        """Nothing but the cut says anything of the sum of the first two scores."""
        scores = ndtri(points)
        narrow = -0.5 * (((scores[:, 0] - scores[:, 1]) / np.sqrt(2)) / 0.1) ** 2
        return np.where(scores[:, 0] + scores[:, 1] > 0, -np.inf, narrow)

    run = sample(1, likelihoods, 6)
    assert np.isfinite(run.log_likelihoods).all()
    assert run.log_evidence == pytest.approx(np.log(0.1 / np.sqrt(1.01)) - np.log(2), abs=0.2)
    total = ndtri(run.points)[:, :2].sum(axis=1)
    assert total.mean() == pytest.approx(-2 / np.sqrt(np.pi), abs=0.1)


def test_a_likelihood_that_is_hardly_anywhere_is_refused():
    with pytest.raises(ValueError, match=r"^only 0 of 10000 draws"):
        sample(1, lambda points: np.full(len(points), -np.inf), 2, 100)


def test_a_constant_likelihood_leaves_the_prior():
    """Even in the tails, where the proposals' are heavier."""
    run = sample(2, lambda points: np.full(len(points), -3.0), 2, 4000)
    assert run.log_evidence == pytest.approx(-3.0, abs=1e-9)
    assert run.points.mean(axis=0) == pytest.approx(np.full(2, 0.5), abs=0.015)
    assert run.points.var(axis=0) == pytest.approx(np.full(2, 1 / 12), rel=0.05)
    assert (ndtri(run.points) ** 4).mean() == pytest.approx(3, abs=0.25)
    assert run.effective > 2500


def test_the_same_seed_gives_the_same_bits_and_progress_is_reported(runs):
    seen = []
    again = sample(0, progress=seen.append)
    assert again.points.tobytes() == runs[0].points.tobytes()
    assert again.log_evidence == runs[0].log_evidence
    temperatures = [state.temperature for state in seen]
    assert temperatures == sorted(set(temperatures))
    assert temperatures[-1] == 1
    assert seen[-1].evaluations == again.evaluations


def test_runs_of_one_density_agree_and_others_do_not(runs):
    found = agreement(runs[0], runs[1])
    assert found.within()
    assert found.log_evidence < 0.5
    assert (found.means < 0.3).all()
    apart = np.zeros(13)
    apart[4] = 0.7 * runs[0].points[:, 4].std()
    moved = agreement(runs[0], replace(runs[0], points=runs[0].points + apart))
    assert moved.means[4] == pytest.approx(0.7 / np.sqrt(1 + 0.7**2 / 4))
    assert not moved.within()
    less = replace(runs[0], log_evidence=runs[0].log_evidence - 2)
    assert not agreement(runs[0], less).within()
    assert agreement(runs[0], less).within(0.01)


def test_categories_have_their_posterior_and_the_evidence_is_exact():
    """Ten categories with unequal priors, each with a mode of its own in two other coordinates."""
    rng = np.random.default_rng(5)
    prior = rng.dirichlet(np.ones(10))
    edges = np.concatenate([[0.0], np.cumsum(prior)])
    edges[-1] = 1.0
    centres, heights, sd = rng.standard_normal((10, 2)), rng.normal(0, 2, 10), 0.3

    def likelihood(points):
        category = np.searchsorted(edges[1:-1], points[:, -1], side="right")
        apart = ndtri(points[:, :2]) - centres[category]
        return heights[category] - 0.5 * (apart**2).sum(axis=1) / sd**2

    runs = [
        temper(likelihood, 3, np.random.default_rng(seed), 2000, edges=edges) for seed in range(2)
    ]
    variance = 1 + sd**2
    log_each = heights + np.log(sd**2 / variance) - 0.5 * (centres**2).sum(axis=1) / variance
    joint = prior * np.exp(log_each)
    counts = np.zeros(10)
    for run in runs:
        assert run.log_evidence == pytest.approx(np.log(joint.sum()), abs=0.15)
        category = np.searchsorted(edges[1:-1], run.points[:, -1], side="right")
        counts += np.bincount(category, minlength=10)
    assert counts / counts.sum() == pytest.approx(joint / joint.sum(), abs=0.03)
    assert agreement(*runs).log_evidence < 0.3
