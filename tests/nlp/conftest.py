import pytest

from aleator.nlp import FilterSQP, Ipopt, Slsqp


@pytest.fixture(params=[FilterSQP, Ipopt, Slsqp], ids=lambda solver: solver.__name__)
def solver(request):
    if request.param is FilterSQP:
        pytest.importorskip("unopy")
    return request.param()
