import pytest

from aleator.nlp import FilterSQP, InteriorPoint, Ipopt, Slsqp


@pytest.fixture(params=[FilterSQP, InteriorPoint, Ipopt, Slsqp], ids=lambda solver: solver.__name__)
def solver(request):
    if request.param in (FilterSQP, InteriorPoint):
        pytest.importorskip("unopy")
    return request.param()
