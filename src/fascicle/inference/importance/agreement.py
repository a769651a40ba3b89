"""Whether two independent runs tell the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.inference.importance.sampling import Run

EVIDENCE_APART = 1.0  # of the log-evidences; more, and one run has missed a mode
MEANS_APART = 0.5  # standard deviations between the means of a parameter


@dataclass(frozen=True)
class Agreement:
    """How far two runs are apart.

    Attributes
    ----------
    log_evidence : float
        Difference of the log-evidences.
    means : (d,) array
        Difference of the means of each parameter, in standard deviations of both together.
    complete : bool
        Whether both reached their effective sample.
    """

    log_evidence: float
    means: Floats
    complete: bool

    @property
    def converged(self) -> bool:
        """Whether both runs are complete, and agree."""
        return (
            self.complete
            and self.log_evidence <= EVIDENCE_APART
            and bool((self.means <= MEANS_APART).all())
        )


def agreement(first: Run, second: Run) -> Agreement:
    """Compare two runs of different seeds on the same likelihood."""
    means = [run.weights @ run.points for run in (first, second)]
    variances = [
        run.weights @ (run.points - mean) ** 2
        for run, mean in zip((first, second), means, strict=True)
    ]
    apart = np.abs(means[0] - means[1])
    together = np.sqrt(np.mean(variances, axis=0) + apart**2 / 4)
    return Agreement(
        abs(first.state.log_evidence - second.state.log_evidence),
        apart / together,
        first.complete and second.complete,
    )
