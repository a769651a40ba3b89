"""The surfaces that trees grow on in these tests."""

import pytest
from builders import half_ellipsoid

from fascicle.purkinje.chart import build_chart
from fascicle.purkinje.growth import find_seed

SURFACES = ["synthetic", "default_heart lv", "crtdemo rv"]


@pytest.fixture(scope="session", params=SURFACES)
def surface(request):
    """Endocardium, chart, seed."""
    if request.param == "synthetic":
        endocardium = half_ellipsoid(jitter=0.2)
    else:
        fixture, side = request.param.split()
        endocardium = getattr(request.getfixturevalue(fixture), side)
    chart = build_chart(endocardium)
    return endocardium, chart, find_seed(endocardium, chart)
